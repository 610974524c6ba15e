/** Speeds by what they are called, in multiples of real time. */
const SPEEDS = { "¼": 0.25, "½": 0.5, "1×": 1, "max": Infinity };

/** Below this distance tenths of a millimetre are shown [mm]. */
const FINE = 10;

/** Said where the goal is dragged to where the arm cannot be. */
const UNREACHABLE = "The arm has no such pose: the goal stays at the last one that it has.";

/** The controls beside the scene; what is chosen is read from it. */
class Panel {
  /** The panel of runs by their labels; `heard` has a function for each of `picked`, `agent`, `view`, `step` and `reset`. */
  constructor(labels, heard) {
    this.parts = Object.fromEntries([...document.querySelectorAll("[id]")].map((part) => [part.id, part]));
    Object.assign(this, { agent: "trained", speed: 1, paused: false });
    const { policy, pause, step, reset } = this.parts;
    labels.forEach((label, i) => policy.add(new Option(label, i)));
    policy.parentElement.hidden = labels.length < 2;
    policy.onchange = () => heard.picked(Number(policy.value));
    segments(this.parts.agent, ["trained", "ik"], "trained", (agent) => {
      this.agent = agent;
      heard.agent();
    });
    segments(this.parts.speed, Object.keys(SPEEDS), "1×", (name) => { this.speed = SPEEDS[name]; });
    segments(this.parts.view, Object.keys(SIDES_OF), "front", heard.view);
    pause.onclick = () => this.pause(!this.paused);
    step.onclick = () => {
      this.pause(true);
      heard.step();
    };
    reset.onclick = heard.reset;
  }

  /** Whether no episode ends. */
  get endless() {
    return this.parts.endless.checked;
  }

  pause(paused) {
    this.paused = paused;
    this.parts.pause.textContent = paused ? "Continue" : "Pause";
  }

  /** Say whose policy is shown. */
  head({ title, task, asks, objects }) {
    document.title = `${title} · ${task} · reachlab`;
    this.parts.agent.lastChild.textContent = objects ? "script" : "ik";
    Object.entries({ title, asks, task }).forEach(([part, text]) => { this.parts[part].textContent = text; });
  }

  /** Write the figures of a player's moment, and how many steps are taken in a second. */
  tell({ episode, failed, episodes, successes, run }, rate, reachable) {
    const distance = 1000 * episode.distance, period = run.facts.control_period;
    const state = failed ? `${failed}: begins again` : episode.reached ? "reached" : "on its way";
    this.write({
      distance: distance.toFixed(distance < FINE ? 2 : 1),
      angle: episode.angle === null ? "" : `${episode.angle.toFixed(3)} rad`,
      state,
      steps: `${episode.clock}`,
      time: `${(episode.clock * period).toFixed(2)} s`,
      count: `${successes} of ${episodes}`,
      rate: this.paused ? "paused" : `${Math.round(rate).toLocaleString("en")}/s`,
      mean: episode.counted === null ? "" : `Root mean square ${(1000 * episode.counted).toFixed(2)} mm`,
      problem: reachable ? "" : UNREACHABLE,
    });
    this.parts.state.className = `state ${failed ? "failed" : episode.reached ? "reached" : ""}`;
  }

  write(texts) {
    for (const [part, text] of Object.entries(texts)) {
      if (this.parts[part].textContent !== text) this.parts[part].textContent = text;
    }
  }
}

/** Buttons of which one is chosen. */
function segments(place, names, first, choose) {
  const buttons = names.map((name) => {
    const button = document.createElement("button");
    Object.assign(button, { type: "button", textContent: name });
    button.onclick = () => {
      buttons.forEach((one) => one.setAttribute("aria-pressed", one === button));
      choose(name);
    };
    button.setAttribute("aria-pressed", name === first);
    return button;
  });
  place.append(...buttons);
}
