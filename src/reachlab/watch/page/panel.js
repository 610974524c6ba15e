/** Speeds by what they are called, in multiples of real time. */
const SPEEDS = { "¼": 0.25, "½": 0.5, "1×": 1, "max": Infinity };

/** Below this distance tenths of a millimetre are shown [mm]. */
const FINE = 10;

/** Said where the goal is dragged to where the arm cannot be. */
const UNREACHABLE = "The arm has no such pose: the goal stays at the last one that it has.";

/** What is shown at once: how many arms, and who moves the others where it is not who moves the first. */
const AT_ONCE = {
  "one": { title: "one episode", count: 1 },
  "beside": { title: "policy and baseline", count: 2 },
  "four": { title: "four episodes", count: 4 },
  "nine": { title: "nine episodes", count: 9 },
};

/** The controls beside the scene; what is chosen is read from it. */
class Panel {
  /**
   * The panel of runs by their labels; `heard` has a function for each of `picked`, `agent`, `episodes`, `once`, `view`,
   * `step` and `reset`.
   */
  constructor(labels, heard) {
    this.parts = Object.fromEntries([...document.querySelectorAll("[id]")].map((part) => [part.id, part]));
    Object.assign(this, { heard, speed: 1, paused: false });
    const { policy, pause, step, reset, once, episodes } = this.parts;
    labels.forEach((label, i) => policy.add(new Option(label, i)));
    policy.parentElement.hidden = labels.length < 2;
    policy.onchange = () => heard.picked(Number(policy.value));
    for (const [name, { title }] of Object.entries(AT_ONCE)) once.add(new Option(title, name));
    once.onchange = () => heard.once();
    episodes.onchange = () => heard.episodes(episodes.value);
    segments(this.parts.speed, titles(Object.keys(SPEEDS)), "1×", (name) => { this.speed = SPEEDS[name]; });
    segments(this.parts.view, titles(Object.keys(SIDES_OF)), "front", heard.view);
    pause.onclick = () => this.pause(!this.paused);
    step.onclick = () => {
      this.pause(true);
      heard.step();
    };
    reset.onclick = heard.reset;
  }

  /** What is shown at once. */
  get once() {
    return AT_ONCE[this.parts.once.value];
  }

  /** Let an agent act. */
  act(agent) {
    this.agent = agent;
    this.mark(agent);
    this.heard.agent();
  }

  /** Whether no episode ends. */
  get endless() {
    return this.parts.endless.checked;
  }

  pause(paused) {
    this.paused = paused;
    this.parts.pause.textContent = paused ? "Continue" : "Pause";
  }

  /** Say whose policy is shown, and offer what goes with it. */
  head({ title, task, asks, agents, agent, begins, record }) {
    const { once, episodes, endless, joints } = this.parts, computed = Boolean(begins);
    document.title = `${title} · ${task} · reachlab`;
    Object.entries({ title, asks, task }).forEach(([part, text]) => { this.parts[part].textContent = text; });
    this.agent = agent;
    const offered = record ? { [agent]: agents[agent] } : { ...agents, [BY_HAND]: BY_HAND };
    this.mark = segments(this.parts.agent, offered, agent, (name) => this.act(name));
    Object.assign(once, { value: "one" }).parentElement.hidden = !computed;
    episodes.replaceChildren(...Object.entries(begins ?? {}).map(([name, { count }]) => new Option(`${name} (${count})`, name)));
    episodes.parentElement.hidden = episodes.options.length < 2;
    for (const part of [endless.parentElement, joints]) part.hidden = Boolean(record);
  }

  /** Write the figures of a player's moment, and how many steps are taken in a second. */
  tell({ episode, failed, run, reachable, picture }, { episodes, successes }, rate, problem) {
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
      problem: problem || (reachable ? "" : UNREACHABLE),
    });
    this.parts.state.className = `state ${failed ? "failed" : episode.reached ? "reached" : ""}`;
    this.parts.observed.hidden = !picture;
    if (picture && this.parts.picture.src !== picture) this.parts.picture.src = picture;
  }

  write(texts) {
    for (const [part, text] of Object.entries(texts)) {
      if (this.parts[part].textContent !== text) this.parts[part].textContent = text;
    }
  }
}

/** Buttons with titles by name, in place of others, of which one is chosen; gives a function that marks another one. */
function segments(place, named, first, choose) {
  const buttons = Object.entries(named).map(([name, title]) => {
    const button = document.createElement("button");
    Object.assign(button, { type: "button", textContent: title, name });
    button.onclick = () => {
      mark(name);
      choose(name);
    };
    return button;
  });
  const mark = (name) => buttons.forEach((one) => one.setAttribute("aria-pressed", one.name === name));
  mark(first);
  place.replaceChildren(...buttons);
  return mark;
}

/** Names as their own titles. */
function titles(names) {
  return Object.fromEntries(names.map((name) => [name, name]));
}
