/** Time for which the end of an episode stays in view [s]. */
const PAUSE = 0.8;

/** Time that is made up for where pictures take longer than they should [s]; the rest is dropped. */
const MOST_BEHIND = 0.25;

/** Time of a picture in which steps are taken at the fastest speed [ms]. */
const FASTEST = 12;

/** Within how many success distances the goal of an object is taken. */
const AROUND = 3;

/** Updates of the panel's figures in a second [1/s]. */
const TEXT_RATE = 10;

/** The page: the runs that it holds, and the loop that plays one of them. */
class Live {
  constructor({ runs, scenes, marks }) {
    Object.assign(this, { sent: runs, scenes, runs: [], shapes: {} });
    this.drawing = new Drawing(document.getElementById("scene"), marks);
    this.view = new View(this.drawing);
    this.hand = new Hand(this.view, () => this.things());
    this.panel = new Panel(runs.map(({ label }) => label), {
      picked: (number) => this.pick(number),
      agent: () => Object.assign(this.player, { episodes: 0, successes: 0 }),
      view: (side) => this.view.begin(side),
      step: () => this.player.over ? this.next() : this.step(),
      reset: () => this.reset(),
    });
    this.perturbation = new Perturbation(document.getElementById("perturb"), (multiples) => {
      this.player.run.simulator.vary(multiples);
    });
    Object.assign(this, { owed: 0, rest: 0, pictures: 0, steps: 0, reachable: true, rate: 0, told: 0, counted: 0 });
  }

  /** Show one of the runs. */
  async pick(number) {
    const { robot } = this.sent[number], scene = this.scenes[robot];
    this.picked = number;
    const run = await this.run(number);
    this.shapes[robot] ??= geometries(scene);
    const shapes = (await this.shapes[robot]).map((one) => one.clone());
    if (this.picked !== number) return;
    this.drawing.show(scene, run, shapes);
    this.drawing.fit();
    this.view.begin();
    this.panel.head(this.sent[number]);
    this.perturbation.begin(this.sent[number]);
    run.simulator.vary?.(this.perturbation.multiples());
    this.player = new Player(run);
    this.reset();
  }

  /** One of the runs, made when it is first asked for. */
  async run(number) {
    if (this.sent[number].physics) this.engine ??= loadEngine();
    const engine = await this.engine;
    return (this.runs[number] ??= new Run(this.sent[number], PROGRAMS[number], engine));
  }

  /** What the hand has to know of the goal, and of the bodies. */
  things() {
    const { episode, run } = this.player, { low, high } = run.facts.goal;
    // An object at the goal is taken at its middle, and the goal around it.
    const radius = run.rules.success_distance * (run.facts.objects ? AROUND : 1);
    return [{ position: episode.goal, low, high, radius }, ...episode.bodies()];
  }

  /** Begin a new episode. */
  reset() {
    this.player.begin();
    Object.assign(this, { owed: 0, rest: PAUSE, reachable: true });
    this.told = 0;
  }

  /** Play the time since the last picture, and draw. */
  frame(now) {
    const elapsed = Math.min((now - (this.before ?? now)) / 1000, MOST_BEHIND);
    this.before = now;
    const dragged = this.hand.take(), { player, panel } = this;
    if (dragged?.number === 0) this.reachable = player.moveGoal(dragged.place);
    else this.holdBody(dragged);
    if (dragged || this.view.chosen) document.getElementById("hint").hidden = true;
    player.follow(this.hand.holds || panel.endless);
    if (!panel.paused) this.play(elapsed);
    this.view.update();
    this.drawing.draw(player);
    this.hand.mark(player.episode.reached);
    this.drawing.keepPace(now);
    this.pictures++;
    this.tell(now);
  }

  /** Take the control steps that are due, or rest where the episode has ended. */
  play(elapsed) {
    const { speed } = this.panel;
    if (speed === Infinity) return this.hurry();
    if (this.player.over) {
      this.rest -= elapsed;
      if (this.rest <= 0) this.next();
      return undefined;
    }
    const period = this.player.run.facts.control_period;
    for (this.owed += speed * elapsed; this.owed >= period && !this.player.over; this.owed -= period) this.step();
    if (this.player.over) Object.assign(this, { owed: 0, rest: PAUSE });
    return undefined;
  }

  /** Take as many control steps as fit into a picture, one episode after the other. */
  hurry() {
    for (const end = performance.now() + FASTEST; performance.now() < end; ) {
      if (this.player.over) this.next();
      this.step();
    }
  }

  /** Put a body where it is dragged to. */
  holdBody(dragged) {
    if (dragged?.number) this.player.moveBody(dragged.number - 1, dragged.place);
  }

  step() {
    this.holdBody(this.hand.held?.at); // what is held does not fall
    this.player.step(this.panel.agent);
    this.steps++;
  }

  next() {
    this.player.proceed();
    this.reachable = true;
  }

  tell(now) {
    const passed = (now - this.told) / 1000;
    if (passed < 1 / TEXT_RATE) return;
    this.rate = this.told ? (this.steps - this.counted) / passed : 0;
    Object.assign(this, { told: now, counted: this.steps });
    this.panel.tell(this.player, this.rate, this.reachable);
  }
}

/** Begin, and let scripts ask the page what it does. */
async function begin() {
  const live = new Live(JSON.parse(document.getElementById("facts").textContent));
  await live.pick(0);
  const frame = (now) => {
    live.frame(now);
    requestAnimationFrame(frame);
  };
  requestAnimationFrame(frame);
  window.reachlab = {
    live,
    /** What became of episodes of a run that begin as given, see `Run.draw` and `playEpisode`. */
    async play({ run, agent, episodes, watched }) {
      const one = await live.run(run), simulator = one.makeSimulator();
      return episodes.map((begin) => playEpisode(one, agent, begin, { simulator, watched }));
    },
    /** So many begins of episodes of a run. */
    async draw(number, count) {
      const run = await live.run(number);
      return Array.from({ length: count }, () => run.draw());
    },
    /** What the page shows now. */
    moment() {
      const { episode, failed, successes, episodes } = live.player;
      const { tool, goal, distance, clock, reached } = episode, [x, y] = live.hand.onScreen(goal);
      const { steps, pictures } = live, box = live.player.run.facts.goal;
      const bodies = live.things().slice(1).map(({ position }) => [...position, ...live.hand.onScreen(position)]);
      return { tool, goal, box, x, y, bodies, distance, clock, reached, failed, successes, episodes, steps, pictures };
    },
  };
}

begin().catch(fail);
