/** Poses drawn at most until one can be reached. */
const DRAWS = 100;

/** Where episodes of a policy's task begin, and what they ask for, by the rules of its training. */
class Goals {
  constructor(arm, facts) {
    Object.assign(this, { arm, rules: facts.rules, box: facts.goal, period: facts.control_period });
    this.capsules = facts.free;
    this.held = rotationOf(facts.arm.held_quaternion);
  }

  /** Joints `[n]` in which an episode starts, and its goal. */
  draw(random) {
    const { arm, rules } = this, noise = rules.start_noise;
    const start = arm.home.map((x, i) => clip(x + random.uniform(-noise, noise), arm.lower[i], arm.upper[i]));
    return { start, goal: this.drawGoal(random) };
  }

  drawGoal(random) {
    if (this.box.moves) return this.drawPath(random);
    if (!this.box.orientation) return makeGoal(random.between(this.box.low, this.box.high));
    for (let i = 0; i < DRAWS; i++) {
      const goal = this.drawPose(random);
      if (goal) return goal;
    }
    return this.goalAt(this.arm.home);
  }

  drawPath(random) {
    const { rules } = this, kind = Math.floor(random.uniform(0, rules.goal_paths.length));
    const speed = random.uniform(...rules.goal_speed);
    const path = PATHS[rules.goal_paths[kind]].sample(this.box, random, speed, rules, this.period);
    return this.onPath([kind, ...path], 0);
  }

  /** The goal of a path `[1 + k]`, the number of its kind and its own, after so many steps. */
  onPath(path, clock) {
    const kind = PATHS[this.rules.goal_paths[path[0]]];
    const { position, velocity } = kind.at(path.slice(1), clock * this.period, this.period);
    return makeGoal(position, { velocity, path });
  }

  /** A pose of the arm: that of random joints, or the held one turned somewhere in the box; null if it has none. */
  drawPose(random) {
    const { arm, box } = this;
    if (this.rules.targets === "any") {
      const q = random.between(arm.lower, arm.upper), { position, rotation } = arm.frames(q);
      return this.pose(position, rotation, arm.home, q, random);
    }
    const turn = this.rules.target_turn.map((most) => random.uniform(-most, most));
    const place = random.between(box.low, box.high);
    return this.pose(place, product(fromEuler(turn), this.held), arm.home, arm.home, random);
  }

  /** A goal at a pose, exactly that of the joints that are found; null where the arm cannot be so, or not freely. */
  pose(position, rotation, near, start, random) {
    const joints = this.arm.nearestJoints(position, rotation, near, start, random);
    return joints && freeOfContact(this.arm, this.capsules, joints) ? this.goalAt(joints) : null;
  }

  goalAt(joints) {
    const { position, rotation } = this.arm.frames(joints);
    return makeGoal(position, { quaternion: quaternionOf(rotation), joints });
  }

  /** A goal put to `[3]` m by hand, turned as it was; one that moves is taken off its path. Null as in `pose`. */
  put(goal, position, near) {
    if (goal.quaternion) return this.pose(position, goal.rotation, near, goal.joints, new Random(0));
    return makeGoal(position, { velocity: goal.velocity && [0, 0, 0] });
  }
}

/** Orientation `[3, 3]` of a roll, pitch and yaw about the world's axes [rad], one after the other. */
function fromEuler([roll, pitch, yaw]) {
  const [c, s] = [Math.cos, Math.sin];
  const x = [[1, 0, 0], [0, c(roll), -s(roll)], [0, s(roll), c(roll)]];
  const y = [[c(pitch), 0, s(pitch)], [0, 1, 0], [-s(pitch), 0, c(pitch)]];
  const z = [[c(yaw), -s(yaw), 0], [s(yaw), c(yaw), 0], [0, 0, 1]];
  return product(z, product(y, x));
}
