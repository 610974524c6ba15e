/** Why an arm does not follow its goal. */
const LEFT = "left the workspace", LATE = "did not arrive in time", TOUCHED = "touched something";

/** Points of a path at most, and their least distance [m]; and that of the points of a goal's trail. */
const PATH_POINTS = 300, PATH_STEP = 0.004, TRAIL_STEP = 0.01;

/** The agent whose joint commands are those of the page's sliders. */
const BY_HAND = "sliders";

/**
 * One arm, driven step by step through held-out episodes; the goal may be moved by hand, and is then followed.
 *
 * As `reachlab.watch.player` does it: while it follows no success ends an episode; the arm rests at the goal where the
 * task does not ask the policy to hold it; and a policy whose episodes all began at home first goes back there on the
 * way it came.
 */
class Player {
  /** A player of a run, whose arm a simulator moves. */
  constructor(run, simulator = run.simulator) {
    Object.assign(this, { run, simulator, following: false, steps: 0, episodes: 0, successes: 0, reachable: true });
    this.restsThere = !run.rules.hold_steps && !run.facts.goal.moves;
    this.begin();
  }

  /** Begin a new episode, or one that began before. */
  begin(first = this.run.draw()) {
    this.first = first;
    this.episode = new Episode(this.run, first, this.simulator);
    Object.assign(this, { touched: this.following, atHome: true, over: false, failed: "", way: [], goingBack: false });
    Object.assign(this, { moved: new Map(), reachable: true, path: new Trace(PATH_STEP), trail: new Trace(TRAIL_STEP) });
    this.look();
  }

  /** Take one control step with an agent, `trained`, `ik` or `sliders`, which bring the joints to what is `wanted`. */
  step(agent, wanted) {
    const { episode } = this, byHand = agent === BY_HAND;
    const instead = byHand ? this.towards(wanted) : this.wayBack(agent);
    const rests = this.restsThere && this.following && episode.near && !byHand;
    episode.step(byHand ? "ik" : agent, rests ? episode.command : instead);
    this.steps++;
    this.look();
    if (this.touched || byHand) {
      this.touched = true;
      this.failed = byHand ? "" : this.failure();
      const { done, success, terminated } = episode;
      this.over = Boolean(this.failed) || (done && !this.following && !byHand && (success || !terminated));
    } else if (episode.done) {
      this.over = true;
      this.episodes++;
      this.successes += episode.success;
    }
  }

  /** The next joint command on the way to one that is `wanted`, at most as far as the joints are fast. */
  towards(wanted) {
    const { speed, control_period: period } = this.run.facts;
    return Array.from(this.episode.command, (x, i) => x + clip(wanted[i] - x, -speed[i] * period, speed[i] * period));
  }

  /** Joint command `[n]` on the way back home; null where the agent acts, whose way is remembered. */
  wayBack(agent) {
    const { way, episode } = this;
    if (!this.run.facts.knows_home_alone) return null;
    if (this.goingBack && way.length && agent === "trained") return way.pop();
    if (this.goingBack) {
      this.goingBack = false;
      episode.ask();
    }
    // An arm at rest makes no way.
    const last = way[way.length - 1];
    if (!last || last.some((x, i) => x !== episode.command[i])) way.push(episode.command);
    return null;
  }

  /** Why the arm does not follow; empty where it does. */
  failure() {
    const { episode } = this, { rules } = this.run;
    if (rules.ends_outside && episode.beyond() > rules.success_distance) return LEFT;
    if (rules.ends_on_contact && episode.terminated) return TOUCHED;
    return episode.clock >= rules.max_steps && !episode.moves && !episode.near ? LATE : "";
  }

  /** Begin the next episode; after a failure to follow begin anew from home, once, with goal and bodies where they are. */
  proceed() {
    const { moved } = this, { goal, moves, state } = this.episode, again = this.failed && (!this.atHome || this.following);
    this.begin(again ? this.first : undefined);
    if (!again) return;
    moved.forEach((position, number) => this.moveBody(number, position));
    if (!moves) this.moveGoal(goal, state.goal_quaternion);
    this.atHome = true;
  }

  /** Follow the goal, or play episodes to their end. */
  follow(following) {
    this.following = following;
    this.touched ||= following;
    this.over &&= Boolean(this.failed) || !following;
  }

  /** Put the goal to `[3]` m and turn it; where the arm cannot be so the goal stays. */
  moveGoal(position, turn) {
    this.reachable = this.episode.place(position, turn);
    if (!this.reachable) return;
    this.goingBack = this.run.facts.knows_home_alone && !this.episode.near && this.way.length > 0;
    Object.assign(this, { touched: true, atHome: false, over: Boolean(this.failed) });
  }

  /** Put a body to `[3]` m. */
  moveBody(number, position) {
    this.moved.set(number, position);
    this.episode.moveBody(number, position);
    Object.assign(this, { touched: true, atHome: false, over: Boolean(this.failed) });
  }

  look() {
    this.path.add(this.episode.tool);
    if (this.episode.moves) this.trail.add(this.episode.goal);
  }
}

/** Where something has been: its newest points `[k, 3]` [m]. */
class Trace {
  constructor(step) {
    Object.assign(this, { step, points: [] });
  }

  add(point) {
    const { points } = this;
    if (points.length && norm(minus(point, points[points.length - 1])) < this.step) return;
    points.push(point);
    if (points.length > PATH_POINTS) points.shift();
  }
}
