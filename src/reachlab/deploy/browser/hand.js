/** How near to the goal's middle a pointer takes it, at least and at most [pixels]: a finger is less exact. */
const GRIP = { mouse: 24, pen: 30, touch: 44 }, LARGEST_GRIP = 90;

/** The hand that drags the goal, by mouse or finger; elsewhere it turns the view. */
class Hand {
  /** A hand on a view; `goal()` tells what of the goal it needs: where it is, its box and its size. */
  constructor(view, goal) {
    Object.assign(this, { view, goal, camera: view.drawing.camera, canvas: view.drawing.renderer.domElement });
    this.held = null;
    this.asked = null;
    this.ring = document.getElementById("ring");
    const listen = (name, heard) => this.canvas.addEventListener(name, heard, { capture: true });
    listen("pointerdown", (event) => this.grab(event));
    listen("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) listen(name, (event) => this.release(event));
  }

  /** Whether the goal is held. */
  get holds() {
    return this.held !== null;
  }

  /** Where the goal was last dragged to `[3]` m, once; null where it was not. */
  take() {
    const { asked } = this;
    this.asked = null;
    return asked;
  }

  grab(event) {
    if (this.holds || event.button || !this.over(event)) return;
    const { position, low, high } = this.goal(), at = new THREE.Vector3(...position);
    // A goal on the table stays there: the pointer is followed on the table, not before the camera.
    const flat = low[2] === high[2];
    const normal = flat ? new THREE.Vector3(0, 0, 1) : this.camera.getWorldDirection(new THREE.Vector3());
    this.plane = new THREE.Plane().setFromNormalAndCoplanarPoint(normal, at);
    const hit = this.hit(event);
    if (!hit) return;
    this.held = { pointer: event.pointerId, offset: minus(position, hit) };
    this.canvas.setPointerCapture(event.pointerId);
    this.view.controls.enabled = false;
  }

  move(event) {
    if (!this.holds) {
      this.canvas.style.cursor = this.over(event) ? "grab" : "";
      return;
    }
    if (event.pointerId !== this.held.pointer) return;
    this.canvas.style.cursor = "grabbing";
    const hit = this.hit(event), { low, high } = this.goal();
    if (hit) this.asked = clipped(add(hit, this.held.offset), low, high);
  }

  release(event) {
    if (!this.holds || event.pointerId !== this.held.pointer) return;
    this.held = null;
    this.canvas.style.cursor = "";
    this.view.controls.enabled = true;
  }

  /** Draw a ring where the goal is taken, also behind the arm, in the colour of one that is `reached`. */
  mark(reached) {
    const [x, y] = this.onScreen(this.goal().position), box = this.canvas.getBoundingClientRect();
    this.ring.style.transform = `translate(${x - box.left}px, ${y - box.top}px)`;
    this.ring.className = `${reached ? "reached" : ""} ${this.holds ? "held" : ""}`;
  }

  /** Whether a pointer is over the goal. */
  over(event) {
    const { position, radius } = this.goal(), [x, y, scale] = this.onScreen(position);
    const grip = clip(radius * scale, GRIP[event.pointerType] ?? GRIP.mouse, LARGEST_GRIP);
    return Math.hypot(event.clientX - x, event.clientY - y) <= grip;
  }

  /** Where a point `[3]` m is on the page [pixels], and how large a metre is there. */
  onScreen(point) {
    const at = new THREE.Vector3(...point), box = this.canvas.getBoundingClientRect();
    const distance = this.camera.position.distanceTo(at), field = (Math.PI * this.camera.fov) / 180;
    at.project(this.camera);
    const scale = box.height / (2 * distance * Math.tan(field / 2));
    return [box.left + ((at.x + 1) * box.width) / 2, box.top + ((1 - at.y) * box.height) / 2, scale];
  }

  /** Where a pointer meets the plane in which the goal is dragged `[3]` m; null where it does not. */
  hit(event) {
    const box = this.canvas.getBoundingClientRect(), ray = new THREE.Raycaster();
    const x = (2 * (event.clientX - box.left)) / box.width - 1, y = 1 - (2 * (event.clientY - box.top)) / box.height;
    ray.setFromCamera(new THREE.Vector2(x, y), this.camera);
    return ray.ray.intersectPlane(this.plane, new THREE.Vector3())?.toArray() ?? null;
  }
}
