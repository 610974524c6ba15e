/** One policy, its task and its arm: what the page holds of it, and its printed functions. */
class Run {
  /** A run of facts and its printed program; `engine` is MuJoCo, which a run without dynamics does not need. */
  constructor(facts, program, engine) {
    Object.assign(this, { facts, rules: facts.rules, begins: arrays(facts.begins), next: 0, engine });
    this.functions = program(arrays(facts.constants));
    this.nothing = facts.action.low.map(() => 0);
    this.free = facts.actuators.map(() => NaN);
    this.simulator = this.makeSimulator();
  }

  /** An arm that nothing else moves. */
  makeSimulator() {
    const { physics, exact } = this.facts;
    return physics ? new Physics(this.engine, physics, arrays(exact)) : new Kinematic(this.facts.control_period);
  }

  /** Joints and goal in which the next episode begins. */
  draw() {
    const i = this.next++ % this.facts.drawn;
    return Object.fromEntries(Object.entries(this.begins).map(([name, part]) => {
      const size = part.length / this.facts.drawn;
      return [name, [...part.subarray(i * size, (i + 1) * size)]];
    }));
  }
}

/** Arrays by name of numbers that are sent as text, each with its type. */
function arrays(sent) {
  const types = { f4: Float32Array, f8: Float64Array, i4: Int32Array, i8: BigInt64Array, b1: Uint8Array };
  return Object.fromEntries(Object.entries(sent).map(([name, { type, data }]) => {
    return [name, new types[type](bytesOf(data).buffer)];
  }));
}

/**
 * An episode in a simulator.
 *
 * `state` holds what the printed functions hand on from step to step.
 */
class Episode {
  /** An episode of a run that begins at joints, with a goal and with bodies, as `Run.draw` gives them. */
  constructor(run, { q, ...beside }, simulator = run.simulator) {
    Object.assign(this, { run, simulator });
    this.ask({ q, qd: q.map(() => 0), command: q, last_action: run.nothing, ...beside });
    simulator.begin(this.state);
  }

  /** Ask for another goal from now on: the arm has all the time of an episode. */
  ask(changed = {}) {
    this.state = this.run.functions.ask({ ...this.state, ...changed });
    this.ended = { success: [false], terminated: [false], done: [false], counted: this.state.distance };
  }

  get tool() { return this.state.tool; }
  get goal() { return this.state.goal_position; }
  get command() { return this.state.command; }
  get clock() { return this.state.clock[0]; }
  get distance() { return this.state.distance[0]; }
  get angle() { return this.state.angle ? this.state.angle[0] : null; }
  get near() { return this.state.near[0]; }
  get success() { return this.ended.success[0]; }
  get terminated() { return this.ended.terminated[0]; }
  get done() { return this.ended.done[0]; }

  /** The error that counts at the end, where it is not the last one; null until any counts. */
  get counted() {
    return this.run.facts.goal.moves && this.clock > this.run.rules.settle_steps ? this.ended.counted[0] : null;
  }

  /** Whether the goal moves by itself; one that was taken off its path does not. */
  get moves() {
    return this.run.facts.goal.moves && !Number.isNaN(this.state.goal_path[0]);
  }

  /** Whether the goal is reached now; of one that moves success tells the whole episode. */
  get reached() {
    return this.run.facts.goal.moves ? this.near : this.success;
  }

  /** Take a control step with an agent, `trained` or `ik`; a command `instead [m]` is taken in place of its own. */
  step(agent, instead = null) {
    const { functions, free } = this.run;
    const decided = { ...this.state, ...functions[agent]({ ...this.state, instead: instead ?? free }) };
    this.state = this.ended = functions.judge({ ...decided, ...this.simulator.step(decided) });
  }

  /** Put the goal to `[3]` m, turned as it was; false where the arm cannot be there, and the goal stays. */
  place(position) {
    const { reached, ...goal } = this.run.functions.place({ ...this.state, position });
    if (reached[0]) this.ask(goal);
    return reached[0];
  }

  /** What a hand has to know of the bodies: those that do not move by themselves stay in the air where they are put. */
  bodies() {
    const { facts } = this.run, { low, high } = facts.workspace, kinds = this.state.bodies_kind ?? [];
    return Array.from(kinds, (_, k) => {
      const position = row(this.state.bodies_position, k, 3), size = row(this.state.bodies_size, k, 3);
      const falls = k >= kinds.length - facts.objects, lowest = falls ? facts.top + Math.max(...size) : low[2];
      return { position, low: [low[0], low[1], lowest], high, radius: Math.max(...size), falls };
    });
  }

  /** Put a body to `[3]` m, where it rests or, if it is one that moves, falls. */
  moveBody(number, position) {
    const places = [...this.state.bodies_position], speeds = [...this.state.bodies_velocity];
    places.splice(3 * number, 3, ...position);
    speeds.fill(0, 6 * number, 6 * number + 6);
    this.ask({ bodies_position: places, bodies_velocity: speeds });
    this.simulator.put(this.state);
  }

  /** How far the tool is outside the workspace [m]. */
  beyond() {
    const { low, high } = this.run.facts.workspace;
    return norm(minus(this.tool, clipped(this.tool, low, high)));
  }
}

/**
 * What became of an episode with an agent: success, steps, those until the goal was first reached, where the tool was
 * `[steps + 1, 3]` m, and joints and bodies after so many steps as are `watched`.
 */
function playEpisode(run, agent, begin, { simulator, watched }) {
  const episode = new Episode(run, begin, simulator), tools = [episode.tool];
  let reached = null, state = null;
  while (!episode.done) {
    episode.step(agent);
    tools.push(episode.tool);
    if (episode.near) reached ??= episode.clock;
    if (episode.clock === watched) state = [...episode.state.q, ...(episode.state.bodies_position ?? [])];
  }
  return { success: episode.success, steps: episode.clock, distance: episode.distance, reached, tools, state };
}
