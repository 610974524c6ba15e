/** One policy, its task and its arm: what the page holds of it, and its printed functions. */
class Run {
  /** The run of a number, of facts and its printed program; `engine` is MuJoCo, which one without dynamics does not need. */
  constructor(number, facts, program, engine) {
    Object.assign(this, { number, facts, rules: facts.rules, engine });
    if (!facts.begins) return; // the page does not compute it
    this.functions = program(arrays(facts.constants));
    this.nothing = facts.action.low.map(() => 0);
    this.forgotten = Array(facts.memory).fill(0);
    this.free = facts.actuators.map(() => NaN);
    this.simulator = this.makeSimulator();
    this.choose("held out");
  }

  /** An arm that nothing else moves. */
  makeSimulator() {
    const { physics, exact, control_period: period } = this.facts;
    return physics ? new Physics(this.engine, physics, arrays(exact)) : new Kinematic(period);
  }

  /** Play the episodes of a name from now on. */
  choose(name) {
    const { count, arrays: sent } = this.facts.begins[name];
    Object.assign(this, { begins: arrays(sent), count, next: 0 });
  }

  /** Joints, goal and bodies in which the next episode begins. */
  draw() {
    const i = this.next++ % this.count;
    return Object.fromEntries(Object.entries(this.begins).map(([name, part]) => {
      const size = part.length / this.count;
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

/** An arm, its goal and what is beside it: arrays of a `state` by name, see `arrays_of` in Python, and what ended. */
class Moment {
  constructor(run) {
    this.run = run;
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
    return this.run.facts.goal.moves && Number.isFinite(this.state.goal_path[0]);
  }

  /** Whether the goal is reached now; of one that moves success tells the whole episode. */
  get reached() {
    return this.run.facts.goal.moves ? this.near : this.success;
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

  /** How far the tool is outside the workspace [m]. */
  beyond() {
    const { low, high } = this.run.facts.workspace;
    return norm(minus(this.tool, clipped(this.tool, low, high)));
  }
}

/** An episode in a simulator, whose `state` holds what the printed functions hand on from step to step. */
class Episode extends Moment {
  /** An episode of a run that begins at joints, with a goal and with bodies, as `Run.draw` gives them. */
  constructor(run, { q, ...beside }, simulator = run.simulator) {
    super(run);
    this.simulator = simulator;
    this.ask({ q, qd: q.map(() => 0), command: q, last_action: run.nothing, memory: run.forgotten, ...beside });
    simulator.begin(this.state);
  }

  /** Ask for another goal from now on: the arm has all the time of an episode. */
  ask(changed = {}) {
    this.state = this.run.functions.ask({ ...this.state, ...changed });
    this.ended = { success: [false], terminated: [false], done: [false], counted: this.state.distance };
  }

  /** Axes and positions of the links and of the tool after them, and of the fingers. */
  frames() {
    const { axes, positions } = this.run.functions.links(this.state);
    return { links: rows(axes, positions), fingers: this.simulator.fingerFrames?.() ?? [] };
  }

  /** Take a control step with an agent, `trained` or `ik`; a command `instead [m]` is taken in place of its own. */
  step(agent, instead = null) {
    const { functions, free } = this.run;
    const decided = { ...this.state, ...functions[agent]({ ...this.state, instead: instead ?? free }) };
    this.state = this.ended = functions.judge({ ...decided, ...this.simulator.step(decided) });
  }

  /** Put the goal to `[3]` m, turned as a quaternion says, wxyz; false where the arm cannot be so, and the goal stays. */
  place(position, turn = this.state.goal_quaternion) {
    const { reached, ...goal } = this.run.functions.place({ ...this.state, position, goal_quaternion: turn });
    if (reached[0]) this.ask(goal);
    return reached[0];
  }

  /** Put a body to `[3]` m, where it rests or, if it is one that moves, falls. */
  moveBody(number, position) {
    const places = [...this.state.bodies_position], speeds = [...this.state.bodies_velocity];
    places.splice(3 * number, 3, ...position);
    speeds.fill(0, 6 * number, 6 * number + 6);
    this.ask({ bodies_position: places, bodies_velocity: speeds });
    this.simulator.put?.(this.state); // a kinematic one holds no bodies of its own
  }
}
