/** What an observation may hold, by the name of its field: numbers `[k]` of a situation. */
const OBSERVED = {
  goal: (now) => now.goal.position,
  tool: (now) => now.frames.position,
  joints: (now) => now.q,
  joint_speeds: (now) => now.qd,
  lag: (now) => minus(now.command, now.q),
  way: (now) => now.way,
  way_near: (now, k) => times(now.way, 1 / (now.distance + k.NEAR)),
  last_action: (now) => now.action,
  tool_axes: (now) => [...column(now.frames.rotation, 0), ...column(now.frames.rotation, 1)],
  goal_axes: (now) => [...column(now.goal.rotation, 0), ...column(now.goal.rotation, 1)],
  turn: (now) => now.turn,
  turn_near: (now, k, weight) => times(now.turn, 1 / (norm(now.turn) + k.NEAR / weight)),
  joint_way: (now) => minus(now.goal.joints, now.q),
  goal_velocity: (now) => now.goal.velocity,
  achieved_goal: (now) => posed(now.goal, now.frames.position, () => quaternionOf(now.frames.rotation)),
  desired_goal: (now) => posed(now.goal, now.goal.position, () => now.goal.quaternion),
};

/** A position `[3]`, and where the goal has an orientation a quaternion too `[7]`. */
function posed(goal, position, quaternion) {
  return goal.quaternion ? [...position, ...quaternion()] : position;
}

/** A goal at a position `[3]` m; what a policy does not need may be left out. */
function makeGoal(position, { quaternion = null, velocity = null, joints = null, path = null } = {}) {
  return { position, quaternion, velocity, joints, path, rotation: quaternion && rotationOf(quaternion) };
}

/** What is known in a control step, and where the tool is. */
function situation(q, qd, frames, goal, command, action) {
  const way = minus(goal.position, frames.position);
  const turn = goal.rotation ? rotationError(frames.rotation, goal.rotation) : [0, 0, 0];
  return { q, qd, frames, goal, command, action, way, distance: norm(way), turn };
}

/** Observations, actions and joint commands of one policy's task. */
class Decider {
  constructor(arm, facts) {
    this.arm = arm;
    this.k = facts.constants;
    this.period = facts.control_period;
    this.lag = facts.arm.lag;
    // No faster than the joints can follow, where they take time to move.
    this.most = Math.max(...this.lag) > 0 ? times(facts.arm.speed, this.period) : null;
    this.fields = facts.observation.fields.map((field) => OBSERVED[field.name]);
    Object.assign(this, { low: facts.action.low, high: facts.action.high, clips: facts.network.clip_actions });
    const joint = facts.action.name.startsWith("joint");
    this.scale = joint ? facts.action.scale : new Array(3).fill(facts.action.scale);
    this.design = DESIGNS[facts.action.name];
    this.held = rotationOf(facts.arm.held_quaternion);
    this.angleWeight = facts.goal.angle_weight;
  }

  /** The observation `[k]`. */
  observe(now) {
    return this.fields.flatMap((field) => field(now, this.k, this.angleWeight));
  }

  /** Action `[a]` with which inverse kinematics goes to the goal. */
  inverseKinematics(now) {
    return this.design.towards(this, now);
  }

  /** The action `[a]` that is taken: clipped to its box, where the task clips. */
  bounded(action) {
    return this.clips ? clipped(action, this.low, this.high) : action;
  }

  /** Joint command `[n]` that a bounded action `[a]` asks for. */
  command(now, action) {
    const wanted = this.design.command(this, now, action);
    if (!this.most) return wanted;
    return wanted.map((x, i) => clip(x, now.command[i] - this.most[i], now.command[i] + this.most[i]));
  }

  /** The tool's command displaced, its orientation held. */
  moveTool(now, action) {
    return this.arm.displaced(now.command, action.map((x, i) => x * this.scale[i]), this.held);
  }

  /** Straight line to the goal at the box's full speed. */
  toolTowards(now) {
    const wanted = now.way.map((x, i) => x / this.scale[i]);
    const excess = Math.max(...wanted.map((x, i) => x / (x > 0 ? this.high[i] : this.low[i])));
    return times(wanted, 1 / Math.max(excess, 1));
  }

  /** Every joint's command displaced. */
  moveJoints(now, action) {
    return clipped(now.command.map((x, i) => x + action[i] * this.scale[i]), this.arm.lower, this.arm.upper);
  }

  /** The same, added to what inverse kinematics would do. */
  correctJoints(now, action) {
    const corrected = add(this.jointsTowards(now), times(action, this.worth(now)));
    return this.moveJoints(now, clipped(corrected, this.low, this.high));
  }

  /** What a correction of 1 is worth in a situation. */
  worth(now) {
    const k = this.k;
    if (now.goal.velocity) return k.MOVING_CORRECTION;
    const away = now.distance + (now.goal.quaternion ? this.angleWeight * angleOf(now.turn) : 0);
    const most = now.goal.joints ? k.POSE_CORRECTION : k.CORRECTION;
    return most * Math.min((away / k.CORRECTION_FADE) ** 2, 1);
  }

  /** What inverse kinematics would do, in displacements of the joints `[n]` of 1. */
  jointsTowards(now) {
    if (now.goal.joints) return this.toJoints(now);
    return now.goal.velocity ? this.withPoint(now) : this.toPoint(now);
  }

  /** To the joints of a pose, each by itself. */
  toJoints(now) {
    const { k, period, lag } = this;
    return this.inBox(now.goal.joints.map((there, i) => {
      const way = there - now.q[i], far = Math.min(Math.abs(way) / k.APPROACH_ANGLE, 1), most = this.arm.speed[i];
      const share = k.JOINT_NEAR + far * (k.JOINT_FAR - k.JOINT_NEAR);
      const asked = clip(Math.min(share / Math.max(lag[i], k.TINY), 1 / period) * way, -most, most);
      return period * asked + far * k.FORESIGHT * lag[i] * (asked - now.qd[i]);
    }));
  }

  /** To a point, in whatever orientation. */
  toPoint(now) {
    const { k, lag } = this, far = Math.min(now.distance / k.APPROACH, 1);
    const gain = k.NEAR_GAIN + far * (k.FAR_GAIN - k.NEAR_GAIN);
    const share = Math.min((gain * this.period) / Math.max(...lag, k.TINY), 1);
    return this.pointStep(now, now.q.map((x, i) => x + far * lag[i] * now.qd[i]), now.goal.position, share);
  }

  /** With a point that moves, whose velocity is fed forward. */
  withPoint(now) {
    const { k, lag } = this, lead = Math.max(...lag) + k.LEAD * this.period;
    const ahead = add(now.goal.position, times(now.goal.velocity, lead));
    return this.pointStep(now, now.q.map((x, i) => x + lag[i] * now.qd[i]), ahead, 1);
  }

  pointStep(now, caughtUp, place, share) {
    const frames = this.arm.frames(caughtUp), wanted = times(minus(place, frames.position), share);
    const most = (this.k.TOOL_SPEED * this.period) / (norm(wanted) + this.k.TINY);
    return this.inBox(this.arm.pointStep(frames, now.command, times(wanted, Math.min(most, 1))));
  }

  inBox(step) {
    return clipped(step.map((x, i) => x / this.scale[i]), this.low, this.high);
  }
}

const MOVE_TOOL = {
  command: (decider, now, action) => decider.moveTool(now, action),
  towards: (decider, now) => decider.toolTowards(now),
};

/** Action designs by name: the joint command `[n]` of an action, and the action of inverse kinematics. */
const DESIGNS = {
  tool_delta: MOVE_TOOL,
  tool_step: MOVE_TOOL,
  joint_delta: {
    command: (decider, now, action) => decider.moveJoints(now, action),
    towards: (decider, now) => decider.jointsTowards(now),
  },
  joint_residual: {
    command: (decider, now, action) => decider.correctJoints(now, action),
    towards: (decider) => decider.low.map(() => 0),
  },
};
