/** Colour of the workspace's edges. */
const EDGES = 0x8d97a8;

/**
 * The table's colour above and at its sides, and how dark the shadow on it is and how far it lies above it, in sizes of
 * the workspace.
 */
const TABLE = [0.835, 0.859, 0.894], TABLE_SIDES = [0.667, 0.702, 0.757], SHADOW_OPACITY = 0.16, SHADOW_ABOVE = 0.0015;

/** Sides of a drawn ball. */
const SIDES = 32;

/** Radius of the knobs by which a goal is turned, and size of the frames of links, in sizes of the workspace [m]. */
const KNOB = 0.011, FRAME = [0.16, 0.003];

/** One arm with its goal, its workspace and what is beside it, as they are drawn. */
class Arm {
  /** An arm of a run at a place `[3]` m among others: what the page holds of it, its meshes by `geometries`, and marks. */
  constructor(scene, run, shapes, marks, place) {
    Object.assign(this, { marks, size: scene.scale, place, group: new THREE.Group() });
    this.group.position.set(...place);
    const links = Math.max(run.facts.joints.length, ...scene.parts.map(({ link }) => link));
    this.links = Array.from({ length: links + 1 }, () => this.added(new THREE.Group(), { matrixAutoUpdate: false }));
    this.shadows = this.added(new THREE.Group(), { matrixAutoUpdate: false });
    flatten(this.shadows.matrix, scene);
    scene.parts.forEach((part, i) => this.addPart(part, shapes[i]));
    this.added(new THREE.LineSegments(lines(scene.edges), new THREE.LineBasicMaterial({ color: EDGES })));
    this.bodies = new BodyMeshes(this.group, this.shadows, marks, run.facts.objects);
    this.goal = this.added(this.makeGoal(run));
    this.axes = run.facts.goal.orientation ? this.added(this.makeAxes(marks.tool_axes)) : null;
    this.path = this.added(polyline(marks.path));
    this.trail = this.added(polyline(marks.trail));
    this.frames = this.links.map(() => Object.assign(this.makeAxes(FRAME), { visible: false })); // shown on demand
    this.frames.forEach((frame, i) => this.links[i].add(frame));
  }

  added(one, settings = {}) {
    this.group.add(one);
    return Object.assign(one, settings);
  }

  /** Add what is drawn of a link in one colour and, but for the table's, its shadow. */
  addPart({ link, colour, table }, geometry) {
    if (table) {
      this.links[link].add(tableTop(geometry));
      return;
    }
    this.links[link].add(new THREE.Mesh(geometry, shaded(colour, colour[3])));
    const shadow = new THREE.Mesh(geometry, SHADOW()), place = new THREE.Group();
    // It moves as the link does.
    this.shadows.add(Object.assign(place, { matrixAutoUpdate: false, matrix: this.links[link].matrix }));
    place.add(Object.assign(shadow, { renderOrder: 1 }));
  }

  /** The goal: a ball, around it the one in which the tool is near enough, and axes to turn it by if it has any. */
  makeGoal(run) {
    const near = run.rules.success_distance, core = Math.min(near, this.marks.target_radius * this.size);
    const goal = new THREE.Group();
    goal.add(ball(core, 1));
    if (near > core) goal.add(ball(near, this.marks.ball_opacity));
    this.balls = goal.children.map((one) => one.material);
    if (!run.facts.goal.orientation) return goal;
    const axes = this.makeAxes(this.marks.target_axes), length = this.marks.target_axes[0] * this.size;
    this.marks.axes.forEach((colour, i) => {
      const knob = new THREE.Mesh(new THREE.SphereGeometry(KNOB * this.size, SIDES, SIDES / 2), shaded(colour));
      knob.position.setComponent(i, length);
      axes.add(knob);
    });
    goal.add(axes);
    return goal;
  }

  /** Red, green and blue rods along x, y and z, of a length and a radius [m] for the tutorial's arm. */
  makeAxes([length, radius]) {
    const axes = new THREE.Group(), rod = [radius * this.size, radius * this.size, length * this.size, 12];
    this.marks.axes.forEach((colour, i) => {
      const geometry = new THREE.CylinderGeometry(...rod).translate(0, rod[2] / 2, 0);
      if (i === 0) geometry.rotateZ(-Math.PI / 2);
      if (i === 2) geometry.rotateX(Math.PI / 2);
      axes.add(new THREE.Mesh(geometry, shaded(colour)));
    });
    return axes;
  }

  /** Draw no shadows, nor mark where they may fall. */
  simplify() {
    this.shadows.visible = false;
    this.group.traverse(({ material }) => { if (material?.stencilWrite) material.stencilWrite = false; });
  }

  /** Draw a player's moment. */
  draw({ episode, path, trail }) {
    const { links, fingers } = episode.frames(), turn = episode.state.goal_quaternion, n = links.length - 1;
    [...links.slice(0, n), ...fingers].forEach((frame, i) => placed(this.links[i + 1], ...frame));
    this.bodies.draw(episode.state);
    this.goal.position.set(...episode.goal);
    if (turn) {
      placed(this.axes, ...links[n]);
      this.goal.quaternion.set(turn[1], turn[2], turn[3], turn[0]);
    }
    const colour = episode.reached ? this.marks.reached : this.marks.waiting;
    this.balls.forEach((material) => material.uniforms.colour.value.copy(rgb(colour)));
    extend(this.path, path.points);
    extend(this.trail, trail.points);
  }
}

/** The table is marked where it is seen; a shadow darkens what is marked, and takes the mark away. */
const MARK = { stencilWrite: true, stencilRef: 1 };
const LET_SHADOWS_IN = { ...MARK, stencilZPass: THREE.ReplaceStencilOp };
const SHADOW = () => new THREE.MeshBasicMaterial({
  ...MARK,
  color: 0,
  transparent: true,
  opacity: SHADOW_OPACITY,
  depthWrite: false,
  stencilFunc: THREE.EqualStencilFunc,
  stencilZPass: THREE.ZeroStencilOp,
});

/** The table, which fills much of the picture: in colours that no light has to be computed for. */
function tableTop(geometry) {
  const { normal } = geometry.attributes, colours = new Float32Array(3 * normal.count);
  for (let i = 0; i < normal.count; i++) {
    colours.set(normal.getZ(i) > 0.5 ? TABLE : TABLE_SIDES, 3 * i);
  }
  geometry.setAttribute("tint", new THREE.BufferAttribute(colours, 3));
  return new THREE.Mesh(geometry, tinted(LET_SHADOWS_IN));
}

/** Set a matrix that brings everything to the table's top along the lamp's light. */
function flatten(matrix, { top, scale }) {
  const [x, y, z] = LAMP_AT, above = top + SHADOW_ABOVE * scale;
  matrix.set(1, 0, -x / z, (above * x) / z, 0, 1, -y / z, (above * y) / z, 0, 0, 0, above, 0, 0, 0, 1);
}

function ball(radius, opacity) {
  return new THREE.Mesh(new THREE.SphereGeometry(radius, SIDES, SIDES / 2), shaded([1, 1, 1], opacity));
}

/** Lines from one point `[3]` to another each. */
function lines(pairs) {
  return new THREE.BufferGeometry().setFromPoints(pairs.flat().map((point) => new THREE.Vector3(...point)));
}

/** A line with room for the points of a `Trace`. */
function polyline(colour) {
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(3 * PATH_POINTS), 3));
  const line = new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: rgb(colour) }));
  return Object.assign(line, { frustumCulled: false });
}

function extend({ geometry }, points) {
  const { position } = geometry.attributes;
  points.forEach((point, i) => position.setXYZ(i, ...point));
  position.needsUpdate = true;
  geometry.setDrawRange(0, points.length);
}

/** Put something where its axes `[9]`, one after the other, and a position `[3]` m say. */
function placed(one, axes, position) {
  one.matrixAutoUpdate = false;
  one.matrix.set(...[0, 1, 2].flatMap((i) => [axes[i], axes[3 + i], axes[6 + i], position[i]]), 0, 0, 0, 1);
  one.matrixWorldNeedsUpdate = true;
}
