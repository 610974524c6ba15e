/** Share of the picture within which an arm at home and its workspace lie. */
const FILLED = 0.92;

/** How near and how far a person may go, in distances of the first view. */
const NEAREST = 0.25, FARTHEST = 3;

/** Where the camera stands in other views, of the way `[3]` to it from what it faces in the first. */
const SIDES_OF = {
  front: (back) => back,
  side: ([x, y, z]) => [-y, x, z],
  above: ([x, y, z]) => [0.02 * x, 0.02 * y, Math.hypot(x, y, z)],
};

/** From where the scene is seen: at first all of it, then as a person turns and zooms it. */
class View {
  constructor(drawing) {
    this.drawing = drawing;
    this.controls = new THREE.OrbitControls(drawing.camera, drawing.renderer.domElement);
    Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.12, maxPolarAngle: 0.6 * Math.PI });
    this.controls.addEventListener("start", () => { this.chosen = true; });
  }

  /** See all of an arm from its front, or from another side. */
  begin(side = this.side ?? "front") {
    Object.assign(this, { chosen: false, side });
    const { from, to: faced, field, scale } = this.drawing.shown, { camera, points } = this.drawing;
    const back = SIDES_OF[side](minus(from, faced)), ahead = times(back, -1 / norm(back)), to = centred(points, faced, ahead);
    camera.fov = (180 * field) / Math.PI;
    const distance = distanceNeeded(points, to, ahead, field, camera.aspect);
    camera.position.set(...minus(to, times(ahead, distance)));
    Object.assign(camera, { near: 0.02 * scale, far: 40 * scale });
    camera.updateProjectionMatrix();
    this.controls.target.set(...to);
    Object.assign(this.controls, { minDistance: NEAREST * distance, maxDistance: FARTHEST * distance });
    this.controls.update();
  }

  /** Keep the picture as large as its place, and all of the arm in it as long as nobody has chosen another view. */
  update() {
    if (this.drawing.fit() && !this.chosen) this.begin();
    this.controls.update();
  }
}

/** Directions to the right and upwards of a picture that looks `ahead`. */
function upright(ahead) {
  const flat = Math.hypot(ahead[0], ahead[1]), right = [ahead[1] / flat, -ahead[0] / flat, 0];
  return [right, cross(right, ahead)];
}

/** A point `[3]` m moved across the picture to where `points` lie as far to one side as to the other. */
function centred(points, middle, ahead) {
  return upright(ahead).reduce((moved, side) => {
    const along = points.map((point) => dot(minus(point, moved), side));
    return add(moved, times(side, (Math.min(...along) + Math.max(...along)) / 2));
  }, middle);
}

/** Distance [m] from which all `points` are seen by a camera that looks `ahead` at `middle`, see `render.scene`. */
function distanceNeeded(points, middle, ahead, field, aspect) {
  const [right, up] = upright(ahead), tall = FILLED * Math.tan(field / 2);
  return Math.max(...points.map((point) => {
    const way = minus(point, middle), sideways = Math.abs(dot(way, right)) / (tall * aspect);
    return Math.max(sideways, Math.abs(dot(way, up)) / tall) - dot(way, ahead);
  }));
}
