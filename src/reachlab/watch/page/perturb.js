/** What may be another than in training: its name, what it is of, and its least and largest multiple. */
const VARIED = {
  gain: { label: "Servo gain", of: "arm", least: 0.5, most: 1.5 },
  mass: { label: "Object mass", of: "object", least: 0.3, most: 3 },
  friction: { label: "Friction", of: "object", least: 0.3, most: 2 },
};

/** Sliders that make the arm, or what it handles, another than the one of training. */
class Perturbation {
  /** Sliders in a part of the page; `changed` is told all multiples by name. */
  constructor(part, changed) {
    Object.assign(this, { part, changed });
    this.rows = Object.entries(VARIED).map(([name, one]) => this.makeRow(name, one));
  }

  makeRow(name, { label, of, least, most }) {
    const [min, max] = [least, most].map(Math.log); // a half lies as far to the left as twice to the right
    const row = slider(label, { min, max, step: "any" });
    this.part.append(row);
    row.slider.oninput = () => {
      this.tell();
      this.changed(this.multiples());
    };
    return Object.assign(row, { name, of });
  }

  /** Multiples by name. */
  multiples() {
    return Object.fromEntries(this.rows.map(({ name, slider }) => [name, Math.exp(Number(slider.value))]));
  }

  /** Show what a run has, as in training. */
  begin({ physics, objects }) {
    this.part.hidden = !physics;
    for (const row of this.rows) {
      row.hidden = row.of === "object" && !objects;
      row.slider.value = 0;
    }
    this.tell();
  }

  tell() {
    for (const { slider, say } of this.rows) say(`${Math.exp(Number(slider.value)).toFixed(2)} ×`);
  }
}
