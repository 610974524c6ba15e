/** Time for which the end of an episode stays in view [s]. */
const PAUSE = 0.8;

/** Time that is made up for where pictures take longer than they should [s]; the rest is dropped. */
const MOST_BEHIND = 0.25;

/** Time of a picture in which steps are taken at the fastest speed [ms]. */
const FASTEST = 12;

/** Within how many success distances the goal of an object is taken. */
const AROUND = 3;

/** Updates of the panel's figures in a second [1/s], and where drawing takes long: they are drawn too. */
const TEXT_RATE = 10, SLOW_TEXT_RATE = 4;

/** The page: the runs that it holds, and the loop that plays one of them on one arm or several. */
class Live {
  constructor({ runs, scenes, marks }) {
    Object.assign(this, { sent: runs, scenes, marks, runs: [], shapes: {}, players: [], problem: "" });
    this.drawing = new Drawing(document.getElementById("scene"), marks);
    this.view = new View(this.drawing);
    this.hand = new Hand(this.view, () => this.things());
    this.panel = new Panel(runs.map(({ label }) => label), {
      picked: (number) => this.pick(number),
      agent: () => this.players.forEach((player) => Object.assign(player, { episodes: 0, successes: 0 })),
      episodes: (name) => {
        this.player.run.choose(name);
        this.reset();
      },
      once: () => this.show(),
      view: (side) => this.view.begin(side),
      step: () => this.single(),
      reset: () => this.reset(),
    });
    this.perturbation = new Perturbation(document.getElementById("perturb"), () => this.vary());
    this.joints = new Joints(document.getElementById("joints"), () => this.panel.act(BY_HAND));
    this.chart = new Chart(document.getElementById("chart"));
    Object.assign(this, { owed: 0, pictures: 0, steps: 0, rate: 0, told: 0, counted: 0 });
  }

  /** The first arm's player, which the panel and the hand are about. */
  get player() {
    return this.players[0];
  }

  /** Show one of the runs. */
  async pick(number) {
    const { robot } = this.sent[number];
    this.picked = number;
    const run = await this.run(number);
    this.shapes[robot] ??= await geometries(this.scenes[robot]);
    if (this.picked !== number) return;
    this.panel.head(this.sent[number]);
    this.perturbation.begin(this.sent[number]);
    this.joints.begin(this.sent[number]);
    this.shown = run;
    this.show();
  }

  /** One of the runs, made when it is first asked for. */
  async run(number) {
    const engine = this.sent[number].physics ? await prepared.engine : null;
    return (this.runs[number] ??= new Run(number, this.sent[number], PROGRAMS[number], engine));
  }

  /** Show as many arms of the run as are chosen, at the begin of an episode each. */
  show() {
    const { shown: run } = this, { count } = this.panel.once;
    this.drawing.show(this.scenes[run.facts.robot], run, this.shapes[run.facts.robot], count);
    this.drawing.fit();
    this.view.begin();
    this.chart.begin(run.facts, count);
    this.players.slice(1).forEach(({ simulator }) => simulator.free?.()); // each but the first has one of its own
    this.players = Array.from({ length: count }, (_, i) => this.makePlayer(run, i));
    this.rests = this.players.map(() => PAUSE);
    if (run.functions) this.vary();
    this.reset();
  }

  makePlayer(run, number) {
    if (run.functions) return new Player(run, number ? run.makeSimulator() : run.simulator);
    return run.facts.record ? new Recording(run) : new Remote(run, (problem) => { this.problem = problem; });
  }

  /** Make the arms as the sliders say. */
  vary() {
    this.players.forEach(({ simulator }) => simulator?.vary?.(this.perturbation.multiples()));
  }

  /** Whether two agents play the same episodes. */
  get paired() {
    return this.players.length === 2;
  }

  /** What the hand may take: the goal, the knobs that turn it, and the bodies of the first arm. */
  things() {
    const { episode, run } = this.player;
    if (!episode || run.facts.record) return [];
    const { low, high, orientation } = run.facts.goal, { target_axes: [length], axes } = this.marks, { size } = this.drawing.arms[0];
    // An object at the goal is taken at its middle, and the goal around it.
    const radius = run.rules.success_distance * (run.facts.objects ? AROUND : 1), turn = episode.state.goal_quaternion;
    const move = (place, turned = turn) => this.together().forEach((player) => player.moveGoal(place, turned));
    const goal = { position: episode.goal, low, high, radius, move };
    const knobs = orientation ? axes.map((_, i) => {
      const axis = rotated(turn, [0, 1, 2].map((j) => Number(i === j)));
      const towards = (place) => move(episode.goal, product(rotation(axis, unit(minus(place, episode.goal))), turn));
      return { position: add(episode.goal, times(axis, length * size)), radius: KNOB * size, move: towards };
    }) : [];
    const bodies = episode.bodies().map((one, k) => {
      return { ...one, body: true, move: (place) => this.together().forEach((player) => player.moveBody(k, place)) };
    });
    return [goal, ...knobs, ...bodies];
  }

  /** The players that a hand moves: both of a pair, else the first. */
  together() {
    return this.paired ? this.players : [this.player];
  }

  /** Begin new episodes. */
  reset() {
    this.players.forEach((player, i) => player.begin(i && this.paired ? this.player.first : undefined));
    Object.assign(this, { owed: 0, told: 0 });
  }

  /** Play the time since the last picture, and draw. */
  frame(now) {
    const elapsed = Math.min((now - (this.before ?? now)) / 1000, MOST_BEHIND), { players, panel } = this;
    this.before = now;
    if (this.hand.drag() || this.view.chosen) document.getElementById("hint").hidden = true;
    players.forEach((player) => player.follow((player === this.player && this.hand.holds) || panel.endless));
    if (!panel.paused) this.play(elapsed);
    players.forEach((player) => player.exchange?.(now));
    this.view.update();
    if (this.player.episode) this.draw(now);
    else this.panel.write({ state: "is made ready", problem: this.problem });
    this.pictures++;
  }

  draw(now) {
    const { drawing, players, joints } = this;
    for (const one of drawing.arms.flatMap(({ frames }) => frames)) one.visible = joints.frames.checked;
    drawing.draw(players);
    this.hand.mark(this.player.episode.reached);
    this.chart.note(players);
    drawing.keepPace(now);
    this.tell(now);
  }

  /** Take the control steps that are due. */
  play(elapsed) {
    const { speed } = this.panel, period = this.shown.facts.control_period;
    if (speed === Infinity) return this.hurry();
    this.owed += speed * elapsed;
    const due = Math.floor(this.owed / period);
    this.owed -= due * period;
    this.players.forEach((player, i) => {
      for (let k = 0; k < due && !player.over && !player.busy; k++) this.step(i);
      this.rests[i] = player.over ? this.rests[i] - elapsed : PAUSE;
      if (this.rests[i] <= 0) this.next(i);
    });
    return undefined;
  }

  /** Take as many control steps as fit into a picture, one episode after the other. */
  hurry() {
    for (const end = performance.now() + FASTEST; performance.now() < end && !this.player.busy; ) {
      this.players.forEach((player, i) => {
        if (player.over) this.next(i);
        if (!player.over) this.step(i);
      });
    }
  }

  /** Take one control step and stand still. */
  single() {
    this.players.forEach((player, i) => {
      if (player.over) this.next(i);
      else this.step(i);
    });
  }

  step(number) {
    const { agent, once } = this.panel, player = this.players[number];
    if (player === this.player) this.hand.hold(); // what is held does not fall
    const other = agent === "ik" ? "trained" : "ik";
    player.step(once.count === 2 && number ? other : agent, this.joints.wanted);
    this.steps++;
  }

  /** What comes after an episode; a pair goes on together. */
  next(number) {
    if (!this.paired) {
      this.players[number].proceed();
    } else if (this.players.every(({ over }) => over)) {
      this.player.proceed();
      this.players[1].begin(this.player.first);
    }
  }

  tell(now) {
    const passed = (now - this.told) / 1000, { players } = this;
    if (passed < 1 / (this.drawing.simple ? SLOW_TEXT_RATE : TEXT_RATE)) return;
    this.rate = this.told ? (this.steps - this.counted) / passed : 0;
    Object.assign(this, { told: now, counted: this.steps });
    const counted = this.paired ? players.slice(0, 1) : players;
    const sum = (name) => counted.reduce((so_far, player) => so_far + player[name], 0);
    this.panel.write({ hint: this.hint() });
    this.panel.tell(this.player, { episodes: sum("episodes"), successes: sum("successes") }, this.rate, this.problem);
    this.joints.tell(this.player.episode.state.q, this.panel.agent === BY_HAND);
    this.chart.draw();
    this.label();
  }

  /** What a hand may do. */
  hint() {
    const [goal, ...others] = this.things(), taken = others.some(({ body }) => body) ? "the goal, or a body" : "the goal";
    return goal ? `Drag ${taken}; drag elsewhere to turn the view.` : "Drag to turn the view.";
  }

  /** Say at the arms of a pair who moves each, and how well. */
  label() {
    const { agent, parts } = this.panel, { agents } = this.shown.facts;
    [agent, agent === "ik" ? "trained" : "ik"].forEach((name, i) => {
      const part = parts[`who${i}`], player = this.players[i];
      part.hidden = !this.paired;
      if (!this.paired) return;
      const { low, high } = this.shown.facts.workspace, middle = times(add(low, high), 0.5);
      const [x, y] = this.hand.onScreen(add([middle[0], middle[1], high[2]], this.drawing.arms[i].place));
      const box = this.drawing.renderer.domElement.getBoundingClientRect();
      part.style.transform = `translate(${x - box.left}px, ${y - box.top}px) translate(-50%, -100%)`;
      part.textContent = `${agents[name] ?? name}: ${player.successes} of ${player.episodes}`;
    });
  }
}

/** Begin, and let scripts ask the page what it does. */
async function begin() {
  const live = new Live(JSON.parse(await text("facts")));
  await live.pick(0);
  const frame = (now) => {
    live.frame(now);
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
  window.reachlab = {
    live,
    /** What the page shows now; null as long as it knows of no arm. */
    moment() {
      if (!live.player.episode) return null;
      const { episode, failed, successes, episodes, over } = live.player;
      const { tool, goal, distance, clock, reached } = episode, [x, y] = live.hand.onScreen(goal);
      const { steps, pictures } = live, box = live.player.run.facts.goal, things = live.things();
      const at = ({ position }) => [...position, ...live.hand.onScreen(position)];
      const bodies = things.filter(({ body }) => body).map(at), knobs = things.slice(1).filter(({ body }) => !body).map(at);
      return {
        ...{ tool, goal, box, x, y, bodies, knobs, distance, clock, reached, over },
        ...{ failed, successes, episodes, steps, pictures, time: live.before },
      };
    },
  };
}

begin().catch(fail);
