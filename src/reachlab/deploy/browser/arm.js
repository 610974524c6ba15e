/** Joints that place a tool in any orientation; with fewer its tilt alone is held. */
const JOINTS_OF_A_POSE = 6;

/** Added to a length that divides [m]. */
const TINY = 1e-6;

/**
 * A serial chain of hinge and slide joints: the tool's pose, its Jacobian, and inverse kinematics.
 *
 * The same formulas as in training, where `reachlab.robots` has them with their sources. Joints are `[n]` rad or m.
 */
class Arm {
  /** The arm of a policy's facts, and the constants of its inverse kinematics. */
  constructor({ frames, ...facts }, constants) {
    Object.assign(this, facts);
    this.constants = constants;
    this.n = facts.slides.length;
    this.fixed = frames.map((rows) => ({
      rotation: rows.slice(0, 3).map((row) => row.slice(0, 3)),
      offset: rows.slice(0, 3).map((row) => row[3]),
    }));
    this.poses = this.n >= JOINTS_OF_A_POSE;
  }

  /** Axes and origins of the joints, poses of the links after their motion, and the tool's position and rotation. */
  frames(q) {
    const axes = [], origins = [], links = [];
    let rotation = [[1, 0, 0], [0, 1, 0], [0, 0, 1]], position = [0, 0, 0];
    for (let i = 0; i < this.n; i++) {
      position = add(position, turned(rotation, this.fixed[i].offset));
      rotation = product(rotation, this.fixed[i].rotation);
      axes.push(column(rotation, 2));
      origins.push(position);
      if (this.slides[i]) position = add(position, times(axes[i], q[i]));
      else rotation = turnedAboutZ(rotation, Math.cos(q[i]), Math.sin(q[i]));
      links.push({ rotation, position });
    }
    const tip = this.fixed[this.n];
    return {
      axes,
      origins,
      links,
      position: add(position, turned(rotation, tip.offset)),
      rotation: product(rotation, tip.rotation),
    };
  }

  /** How the joints move the tool `[n, 3]`. */
  linear(frames) {
    return frames.axes.map((axis, i) =>
      this.slides[i] ? axis : cross(axis, minus(frames.position, frames.origins[i])));
  }

  /** How the joints turn the tool `[n, 3]`. */
  angular(frames) {
    return frames.axes.map((axis, i) => (this.slides[i] ? [0, 0, 0] : axis));
  }

  /** Displacement `[n]` of a command `[n]` that moves the tool by `wanted [3]` m, linearised where it is now. */
  pointStep(frames, command, wanted) {
    const columns = this.linear(frames), free = new Array(this.n).fill(true);
    let stopped = new Array(this.n).fill(0), step = stopped;
    for (let pass = 0; pass < this.constants.LIMIT_PASSES; pass++) {
      const left = columns.reduce((sum, one, i) => minus(sum, times(one, stopped[i])), wanted);
      const masked = columns.map((one, i) => (free[i] ? one : [0, 0, 0]));
      const solved = leastSquares(masked, left, this.constants.POINT_DAMPING);
      const asked = command.map((x, i) => x + (stopped[i] + solved[i]));
      const allowed = clipped(asked, this.lower, this.upper);
      step = minus(allowed, command);
      const met = free.map((is, i) => is && allowed[i] !== asked[i]);
      if (!met.includes(true)) break;
      met.forEach((is, i) => { if (is) free[i] = false; });
      stopped = step.map((x, i) => (free[i] ? 0 : x));
    }
    return step;
  }

  /** Joints `[n]` one step from `[n]` towards a tool displaced by `[3]` m, in an orientation `[3, 3]`. */
  displaced(q, displacement, rotation) {
    const { MAX_TURN, DAMPING, MAX_JOINT_STEP } = this.constants;
    const [turn, columns] = this.turnTo(this.frames(q), rotation);
    const error = [...displacement, ...times(turn, MAX_TURN / Math.max(norm(turn), MAX_TURN))];
    return this.boundedStep(q, columns, error, DAMPING, MAX_JOINT_STEP);
  }

  /** Rotation error `[3]` from the tool to an orientation `[3, 3]`, and the Jacobian's columns `[n, 6]` for it. */
  turnTo(frames, rotation) {
    const linear = this.linear(frames), angular = this.angular(frames);
    if (this.poses) {
      return [rotationError(frames.rotation, rotation), linear.map((one, i) => [...one, ...angular[i]])];
    }
    const axis = turned(frames.rotation, this.approach), down = turned(rotation, this.approach)[2];
    const out = minus(frames.position, frames.origins[0]), length = Math.hypot(out[0], out[1]) + TINY;
    const across = [-out[1] / length, out[0] / length, 0], aside = Math.sqrt(Math.max(1 - down * down, 0));
    const wanted = [aside * across[1], -aside * across[0], down];
    const turn = times(across, dot(across, cross(axis, wanted)));
    return [turn, linear.map((one, i) => [...one, ...times(across, dot(across, angular[i]))])];
  }

  /** Joints `[n]` after a step that mends an error `[6]`, of at most `bound` a joint, in the limits. */
  boundedStep(q, columns, error, damping, bound) {
    const step = leastSquares(columns, error, damping), scale = bound / Math.max(largest(step), bound);
    const stopped = clipped(add(q, times(step, scale)), this.lower, this.upper);
    const linear = columns.map((one) => one.slice(0, 3));
    const left = linear.reduce(
      (sum, one, i) => minus(sum, times(one, stopped[i] - q[i])), times(error.slice(0, 3), scale));
    const masked = linear.map((one, i) => (stopped[i] > this.lower[i] && stopped[i] < this.upper[i] ? one : [0, 0, 0]));
    const repair = leastSquares(masked, left, damping), shorten = bound / Math.max(largest(repair), bound);
    return clipped(add(stopped, times(repair, shorten)), this.lower, this.upper);
  }

  /**
   * Joints `[n]` of a pose, the soonest reached from `near [n]` of all that are found; null where none are.
   *
   * Solved for from there, from `start [n]` and from random joints.
   */
  nearestJoints(position, rotation, near, start, random) {
    let best = null, soonest = Infinity;
    for (let i = 0; i < this.constants.STARTS + 2; i++) {
      const from = i === 0 ? near : i === 1 ? start : random.between(this.lower, this.upper);
      const found = this.solvePose(position, rotation, from);
      const q = found && found.map((x, j) => this.turnedBack(x, near[j], j));
      const duration = q ? largest(q.map((x, j) => (x - near[j]) / this.speed[j])) : Infinity;
      if (duration < soonest) [best, soonest] = [q, duration];
    }
    return best;
  }

  /** Joints `[n]` of a pose from others, by Newton steps damped by the square of the error; null where it fails. */
  solvePose(position, rotation, start) {
    const k = this.constants;
    let q = start;
    for (let step = 0; ; step++) {
      const frames = this.frames(q), [turn, columns] = this.turnTo(frames, rotation);
      const way = minus(position, frames.position), distance = norm(way), angle = norm(turn);
      if (distance <= k.POSITION_TOLERANCE && angle <= k.ANGLE_TOLERANCE) return q;
      if (step === k.ITERATIONS) return null;
      const damping = k.DAMPING + k.SUGIHARA * (distance * distance + angle * angle);
      q = this.boundedStep(q, columns, [...way, ...turn], damping, k.MAX_SOLVER_STEP);
    }
  }

  /** A hinge with more than a turn of play is in the same place a turn away: the nearest such place within limits. */
  turnedBack(x, near, joint) {
    if (this.slides[joint]) return x;
    const back = x - 2 * Math.PI * Math.round((x - near) / (2 * Math.PI));
    return back >= this.lower[joint] && back <= this.upper[joint] ? back : x;
  }
}

/** A matrix turned about its own z axis. */
function turnedAboutZ(matrix, cos, sin) {
  return matrix.map(([x, y, z]) => [x * cos + y * sin, y * cos - x * sin, z]);
}
