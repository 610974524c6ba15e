/** Why an arm does not follow its goal. */
const LEFT = "left the workspace", LATE = "did not arrive in time";

/** Points of a path at most, and their least distance [m]; and that of the points of a goal's trail. */
const PATH_POINTS = 300, PATH_STEP = 0.004, TRAIL_STEP = 0.01;

/**
 * One arm, driven step by step through random episodes; the goal may be moved by hand, and is then followed.
 *
 * As `reachlab.watch.player` does it: while it follows no success ends an episode; the arm rests at the goal where the
 * task does not ask the policy to hold it; and a policy whose episodes all began at home first goes back there on the
 * way it came.
 */
class Player {
  constructor(run) {
    Object.assign(this, { run, following: false, steps: 0, episodes: 0, successes: 0 });
    this.restsThere = !run.rules.hold_steps && !run.facts.goal.moves;
    this.begin();
  }

  /** Begin a new episode, or one that began before. */
  begin(first = this.run.draw()) {
    this.first = first;
    this.episode = new Episode(this.run, first);
    Object.assign(this, { touched: this.following, atHome: true, over: false, failed: "", way: [], goingBack: false });
    this.path = new Trace(PATH_STEP);
    this.trail = new Trace(TRAIL_STEP);
    this.look();
  }

  /** Take one control step with an agent, `trained` or `ik`. */
  step(agent) {
    const { episode } = this, instead = this.wayBack(agent);
    const rests = this.restsThere && this.following && episode.near;
    episode.step(agent, rests ? episode.command : instead);
    this.steps++;
    this.look();
    if (this.touched) {
      this.failed = this.failure();
      const { done, success, terminated } = episode;
      this.over = Boolean(this.failed) || (done && !this.following && (success || !terminated));
    } else if (episode.done) {
      this.over = true;
      this.episodes++;
      this.successes += episode.success;
    }
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
    return episode.clock >= rules.max_steps && !episode.moves && !episode.near ? LATE : "";
  }

  /** Begin the next episode; after a failure to follow begin anew from home, once, with the goal where it is. */
  proceed() {
    const { goal, moves } = this.episode, again = this.failed && (!this.atHome || this.following);
    this.begin(again ? this.first : undefined);
    if (!again) return;
    if (!moves) this.moveGoal(goal);
    this.atHome = true;
  }

  /** Follow the goal, or play episodes to their end. */
  follow(following) {
    this.following = following;
    this.touched ||= following;
    this.over &&= Boolean(this.failed) || !following;
  }

  /** Put the goal to `[3]` m; false where the arm cannot be there, and the goal stays. */
  moveGoal(position) {
    if (!this.episode.place(position)) return false;
    this.goingBack = this.run.facts.knows_home_alone && !this.episode.near && this.way.length > 0;
    Object.assign(this, { touched: true, atHome: false, over: Boolean(this.failed) });
    return true;
  }

  /** Put a body to `[3]` m. */
  moveBody(number, position) {
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
