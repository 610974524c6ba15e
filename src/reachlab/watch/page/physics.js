/* Simulators of the page: MuJoCo, compiled to WebAssembly, and joints that follow their commands without dynamics. */

/** An arm without dynamics: its joints are where they are commanded. */
class Kinematic {
  constructor(period) {
    this.period = period;
  }

  begin() {}

  /** What has moved in a control period, of what is `wanted`. */
  step(state) {
    const { q, wanted } = state;
    return { moved_q: wanted, moved_qd: times(minus([...wanted], q), 1 / this.period), ...unmoved(state) };
  }
}

/** Bodies of a state as they are, where nothing moves them. */
function unmoved(state) {
  const names = Object.keys(state).filter((name) => name.startsWith("bodies_"));
  return Object.fromEntries(names.map((name) => [`moved_${name}`, [...state[name]]]));
}

/** An arm under full dynamics, as in training: its servos, contacts, and the objects that it moves. */
class Physics {
  /** An arm of facts, see `physics.py`, with arrays by name of what its model has in more digits. */
  constructor(engine, { xml, substeps, layout, gripper }, exact) {
    Object.assign(this, { engine, substeps, layout, gripper });
    this.model = engine.MjModel.from_xml_string(xml);
    for (const [name, values] of Object.entries(exact)) this.set(name, values);
    this.data = new engine.MjData(this.model);
    const names = ["actuator_gainprm", "actuator_biasprm", "body_mass", "body_inertia", "pair_friction"];
    this.usual = Object.fromEntries(names.map((name) => [name, this.model[name].slice()]));
  }

  /** Give back the engine's memory. */
  free() {
    this.data.delete();
    this.model.delete();
  }

  /** Make servos and objects so many times as stiff, as heavy and as rough as in training. */
  vary({ gain, mass, friction }) {
    const { model, layout, usual, engine } = this;
    const scale = (name, places, factor) => places.forEach((i) => { model[name][i] = factor * usual[name][i]; });
    scale("actuator_gainprm", layout.servos.map((servo) => 10 * servo), gain);
    scale("actuator_biasprm", layout.servos.flatMap((servo) => [10 * servo + 1, 10 * servo + 2]), gain);
    scale("body_mass", layout.object_bodies, mass);
    scale("body_inertia", layout.object_bodies.flatMap((body) => [0, 1, 2].map((i) => 3 * body + i)), mass);
    scale("pair_friction", layout.object_pairs.flatMap((pair) => [5 * pair, 5 * pair + 1]), friction);
    const scratch = new engine.MjData(model);
    engine.mj_setConst(model, scratch);
    scratch.delete();
  }

  /** Set an array of the model, or a number of its options. */
  set(name, values) {
    const [owner, key] = name.startsWith("opt.") ? [this.model.opt, name.slice(4)] : [this.model, name];
    if (typeof owner[key] === "number") [owner[key]] = values;
    else owner[key].set(values);
  }

  /** Put arm and bodies where a state has them, at rest. */
  begin(state) {
    const { data, layout } = this, n = layout.joints.length;
    this.engine.mj_resetData(this.model, data);
    layout.joints.forEach((place, i) => { data.qpos[place] = state.q[i]; });
    layout.fingers.forEach((place, i) => { data.qpos[place] = this.fingers(state.q[n])[i]; });
    this.command(state.q);
    this.put(state);
    this.engine.mj_kinematics(this.model, data);
  }

  /** Axes `[9]`, one after the other, and positions `[3]` m of the fingers. */
  fingerFrames() {
    const { xmat, xpos } = this.data;
    return this.layout.finger_bodies.map((body) => {
      const turn = row(xmat, body, 9);
      return [[0, 3, 6, 1, 4, 7, 2, 5, 8].map((i) => turn[i]), row(xpos, body, 3)];
    });
  }

  /** Put the bodies where a state has them: objects, and those that do not move by themselves. */
  put(state) {
    const { data, layout } = this, objects = layout.objects.length / 7, kinds = state.bodies_kind ?? [];
    for (let k = 0; k < objects; k++) {
      const body = kinds.length - objects + k;
      const pose = [...row(state.bodies_position, body, 3), ...row(state.bodies_quaternion, body, 4)];
      pose.forEach((x, i) => { data.qpos[layout.objects[7 * k + i]] = x; });
      row(state.bodies_velocity, body, 6).forEach((x, i) => { data.qvel[layout.object_speeds[6 * k + i]] = x; });
    }
    this.arrange(state);
  }

  /** Put the bodies that the engine does not move where a state has them. */
  arrange(state) {
    const { model, layout } = this;
    layout.fixed.forEach((geom, k) => {
      const size = row(state.bodies_size, k, 3), kind = state.bodies_kind[k];
      model.geom_type[geom] = kind;
      model.geom_pos.set(row(state.bodies_position, k, 3), 3 * geom);
      model.geom_quat.set(row(state.bodies_quaternion, k, 4), 4 * geom);
      model.geom_size.set(size, 3 * geom);
      model.geom_sameframe[geom] = 0;
      model.geom_rbound[geom] = Math.max(kind === BOX ? norm(size) : size[0] + size[1], 1e-6);
    });
  }

  /** What has moved in a control period, of what is `wanted`. */
  step(state) {
    const { data, model, engine, layout } = this, objects = layout.objects.length / 7;
    this.arrange(state);
    this.command(state.wanted);
    let touched = false;
    for (let i = 0; i < this.substeps; i++) {
      engine.mj_step(model, data);
      touched ||= data.ncon > 0;
    }
    const { qpos, qvel } = data, joints = layout.joints.map((i) => Math.fround(qpos[i]));
    const moved = { moved_q: joints.concat(this.opening(qpos)), moved_qd: layout.speeds.map((i) => Math.fround(qvel[i])) };
    Object.assign(moved, unmoved(state));
    if (this.gripper) moved.moved_qd.push(0);
    for (let k = 0; k < objects; k++) {
      const body = state.bodies_kind.length - objects + k;
      const pose = layout.objects.slice(7 * k, 7 * k + 7).map((i) => Math.fround(qpos[i]));
      const speed = layout.object_speeds.slice(6 * k, 6 * k + 6).map((i) => Math.fround(qvel[i]));
      moved.moved_bodies_position.splice(3 * body, 3, ...pose.slice(0, 3));
      moved.moved_bodies_quaternion.splice(4 * body, 4, ...pose.slice(3));
      moved.moved_bodies_velocity.splice(6 * body, 6, ...speed);
    }
    return { ...moved, contact: [touched] };
  }

  /** Set the servos' targets to a command `[m]`. */
  command(wanted) {
    const { data, layout } = this, n = layout.servos.length;
    layout.servos.forEach((servo, i) => { data.ctrl[servo] = wanted[i]; });
    layout.finger_servos.forEach((servo, i) => { data.ctrl[servo] = this.fingers(wanted[n])[i]; });
  }

  /** Positions of the fingers' joints at an opening [m]. */
  fingers(opening) {
    const { closed, open, widest, way } = this.gripper, share = between(opening / widest, evenly(way), way);
    return closed.map((start, i) => start + share * (open[i] - start));
  }

  /** Opening [m] of the fingers, as a list; an empty one where none are driven. */
  opening(qpos) {
    if (!this.gripper) return [];
    const { closed, open, widest, way } = this.gripper;
    const shares = this.layout.fingers.map((place, i) => (qpos[place] - closed[i]) / (open[i] - closed[i]));
    return [Math.fround(widest * between(shares.reduce((sum, x) => sum + x, 0) / shares.length, way, evenly(way)))];
  }
}

/** Kind of a box among bodies. */
const BOX = 6;

/** Numbers from 0 to 1, as many as are in a list. */
function evenly(list) {
  return list.map((_, i) => i / (list.length - 1));
}

/** Value of a curve through points `(x, y)` at a place, as at its ends beyond them. */
function between(place, x, y) {
  const i = x.findIndex((one) => one > place);
  if (i <= 0) return i === 0 ? y[0] : y[y.length - 1];
  return y[i - 1] + ((place - x[i - 1]) / (x[i] - x[i - 1])) * (y[i] - y[i - 1]);
}

/** One row of so many numbers in an array. */
function row(array, number, size) {
  return Array.from(array.slice(size * number, size * (number + 1)));
}

/** Axes `[9]`, one after the other, and positions `[3]` m of links, of arrays with a row for each. */
function rows(axes, positions) {
  return Array.from({ length: positions.length / 3 }, (_, i) => [row(axes, i, 9), row(positions, i, 3)]);
}
