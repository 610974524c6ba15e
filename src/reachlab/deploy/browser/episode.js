/** One policy, its task and its arm, of the page's facts. */
class Run {
  constructor(facts) {
    this.facts = facts;
    this.rules = facts.rules;
    this.arm = new Arm(facts.arm, facts.constants);
    this.decider = new Decider(this.arm, facts);
    this.network = new Network(facts.weights, facts.network);
    this.goals = new Goals(this.arm, facts);
    this.nothing = facts.action.low.map(() => 0);
  }
}

/** Agents by name: the action `[a]` in a situation. */
const AGENTS = {
  trained: ({ network, decider }, now) => network.act(decider.observe(now)),
  ik: ({ decider }, now) => decider.inverseKinematics(now),
};

/**
 * An episode in a simulator without dynamics: joints follow their commands at once or, if they have a lag, after it.
 *
 * After a step `done` tells that it has ended, `success` that the task is solved, `outside` that the tool has left the
 * workspace.
 */
class Episode {
  /** An episode of a run that starts at joints `[n]`. */
  constructor(run, { start, goal }) {
    Object.assign(this, { run, goal, q: start, qd: start.map(() => 0), command: start, action: run.nothing });
    this.frames = run.arm.frames(start);
    this.done = this.success = this.outside = false;
    this.renew();
  }

  /** Ask for another goal from now on. */
  ask(goal) {
    this.goal = goal;
    this.renew();
  }

  /** Give the arm all the time of an episode again. */
  renew() {
    this.clock = 0;
    this.meanSquare = null;
    this.held = [];
    this.remember();
  }

  /** What agents may know now. */
  situation() {
    const hidden = this.goal.velocity && !this.run.rules.goal_velocity;
    const goal = hidden ? { ...this.goal, velocity: [0, 0, 0] } : this.goal;
    return situation(this.q, this.qd, this.frames, goal, this.command, this.action);
  }

  /** Take a control step with an agent of `AGENTS`; a command `instead [n]` is taken in place of its own. */
  step(agent, instead = null) {
    const { decider, rules, arm, goals } = this.run, now = this.situation();
    const action = decider.bounded(AGENTS[agent](this.run, now));
    const rests = rules.at_goal === "hold" && this.near();
    const command = instead ?? (rests ? this.command : decider.command(now, action));
    this.move(command);
    Object.assign(this, { command, action, frames: arm.frames(this.q), clock: this.clock + 1 });
    if (this.goal.path) this.goal = goals.onPath(this.goal.path, this.clock);
    this.remember();
    this.judge();
  }

  /** Move the joints for a control period: at once to a command `[n]`, or after it by the time of their lag. */
  move(command) {
    const { control_period: period } = this.run.facts, { lag } = this.run.decider;
    const q = command.map((x, i) => (lag[i] ? x + (this.q[i] - x) * Math.exp(-period / lag[i]) : x));
    this.qd = q.map((x, i) => (lag[i] ? (command[i] - x) / lag[i] : (x - this.q[i]) / period));
    this.q = q;
  }

  /** Take note of the errors after this step. */
  remember() {
    const { rules } = this.run;
    this.distance = norm(minus(this.goal.position, this.frames.position));
    this.angle = this.goal.rotation && angleOf(rotationError(this.frames.rotation, this.goal.rotation));
    const square = this.distance ** 2, still = largest(this.qd) < rules.hold_speed;
    if (this.goal.velocity) {
      const counted = Math.max(this.clock - rules.settle_steps, 1);
      this.meanSquare = this.meanSquare === null ? square : this.meanSquare + (square - this.meanSquare) / counted;
    }
    if (this.clock && rules.hold_steps) this.held = [...this.held, still && this.near()].slice(-rules.hold_steps);
  }

  judge() {
    const { rules } = this.run;
    this.outside = rules.ends_outside && this.beyond() > 0;
    this.success = !this.outside && this.solved();
    const ended = rules.at_goal === "end" && this.success;
    this.terminated = this.outside || ended;
    this.done = this.terminated || this.clock >= rules.max_steps;
  }

  /** How far the tool is outside the workspace [m]. */
  beyond() {
    const tool = this.frames.position, { low, high } = this.run.facts.workspace;
    return norm(minus(tool, clipped(tool, low, high)));
  }

  /** Whether the tool is at the goal now. */
  near() {
    const { success_distance, success_angle } = this.run.rules;
    return this.distance < success_distance && (this.angle === null || this.angle < success_angle);
  }

  /** Whether the errors that count are those of a success. */
  solved() {
    const { rules } = this.run;
    if (this.meanSquare !== null) return Math.sqrt(this.meanSquare) < rules.success_distance;
    if (!rules.hold_steps) return this.near();
    return this.held.length === rules.hold_steps && this.held.every(Boolean);
  }

  /** Whether the goal is reached now; of one that moves `solved` tells the whole episode. */
  reached() {
    return this.meanSquare === null ? this.solved() : this.near();
  }
}

/** What became of an episode with an agent: success, steps and where the tool was `[steps + 1, 3]` m. */
function playEpisode(run, agent, begin) {
  const episode = new Episode(run, begin), tools = [episode.frames.position];
  while (!episode.done) {
    episode.step(agent);
    tools.push(episode.frames.position);
  }
  return { success: episode.success, steps: episode.clock, distance: episode.distance, tools };
}
