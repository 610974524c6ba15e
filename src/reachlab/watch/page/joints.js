/** Share of its range within which a joint is at its limit. */
const AT_LIMIT = 0.02;

/** The joints within their limits, as sliders: they show where each is, or say where it shall be. */
class Joints {
  /** Sliders in a part of the page; `moved` is called when a person moves one. */
  constructor(part, moved) {
    Object.assign(this, { part, moved, rows: [], wanted: [] });
    this.frames = document.getElementById("frames");
  }

  /** Show the joints of a run. */
  begin({ actuators, limits: { lower, upper }, slides }) {
    this.rows.forEach((row) => row.remove());
    this.rows = actuators.map((name, i) => {
      const row = slider(name, { min: lower[i], max: upper[i], step: "any" });
      row.slider.oninput = () => {
        this.wanted = this.rows.map((one) => Number(one.slider.value));
        this.moved();
      };
      return Object.assign(row, { degrees: i < slides.length && !slides[i] });
    });
    this.part.append(...this.rows);
  }

  /** Show where the joints are, of a command that is not by hand. */
  tell(q, byHand) {
    if (!byHand) this.wanted = [...q];
    if (!this.part.open) return;
    this.rows.forEach(({ slider: one, say, degrees, classList }, i) => {
      if (!byHand) one.value = q[i];
      const share = (q[i] - one.min) / (one.max - one.min);
      say(degrees ? `${((180 * q[i]) / Math.PI).toFixed(1)}°` : `${(1000 * q[i]).toFixed(1)} mm`);
      classList.toggle("limit", share < AT_LIMIT || share > 1 - AT_LIMIT);
    });
  }
}

/** A row of the panel: a name, a slider with these settings, and a function that says what it stands for. */
function slider(name, settings) {
  const row = document.createElement("label"), text = document.createElement("span");
  const one = document.createElement("input"), told = document.createElement("output");
  Object.assign(one, { type: "range", ...settings });
  text.textContent = name;
  row.className = "slider";
  told.ariaLive = "off";
  row.append(text, one, told);
  const say = (what) => {
    told.textContent = what;
    one.setAttribute("aria-valuetext", what);
  };
  return Object.assign(row, { slider: one, say });
}
