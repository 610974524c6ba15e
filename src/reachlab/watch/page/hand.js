/** How near to the goal's middle a pointer takes it, at least and at most [pixels]: a finger is less exact. */
const GRIP = { mouse: 24, pen: 30, touch: 44 }, LARGEST_GRIP = 90;

/** How far an object on the table is lifted by the hand that holds it [m]; it falls when it is let go. */
const LIFTED = 0.03;

/** The hand that drags the goal and bodies, by mouse or finger; elsewhere it turns the view. */
class Hand {
  /**
   * A hand on a view. `things()` gives what it may take, first the goal: where each is, its size, the box `low` to `high`
   * in which it moves if there is one, whether it falls, and how to `move` it to a place `[3]` m.
   */
  constructor(view, things) {
    Object.assign(this, { view, things, camera: view.drawing.camera, canvas: view.drawing.renderer.domElement });
    this.held = null;
    this.asked = null;
    this.ring = document.getElementById("ring");
    const listen = (name, heard) => this.canvas.addEventListener(name, heard, { capture: true });
    listen("pointerdown", (event) => this.grab(event));
    listen("pointermove", (event) => this.move(event));
    for (const name of ["pointerup", "pointercancel"]) listen(name, (event) => this.release(event));
  }

  /** Whether anything is held. */
  get holds() {
    return this.held !== null;
  }

  /** Move what is dragged to where it was last dragged; true where there is any. */
  drag() {
    const { asked } = this;
    this.asked = null;
    asked?.thing.move(asked.place);
    return Boolean(asked);
  }

  /** Keep what falls where it is held. */
  hold() {
    if (this.held?.at?.thing.falls) this.held.at.thing.move(this.held.at.place);
  }

  grab(event) {
    const number = this.holds || event.button ? -1 : this.over(event);
    if (number < 0) return;
    const thing = this.things()[number], { position, low, high, falls } = thing, at = new THREE.Vector3(...position);
    // What is on the table is moved along it: the pointer is followed there, not before the camera.
    const flat = falls || (low && low[2] === high[2]);
    const normal = flat ? new THREE.Vector3(0, 0, 1) : this.camera.getWorldDirection(new THREE.Vector3());
    this.plane = new THREE.Plane().setFromNormalAndCoplanarPoint(normal, at);
    const hit = this.hit(event);
    if (!hit) return;
    const offset = add(minus(position, hit), [0, 0, falls ? LIFTED : 0]);
    this.held = { thing, pointer: event.pointerId, offset };
    this.canvas.setPointerCapture(event.pointerId);
    this.view.controls.enabled = false;
  }

  move(event) {
    if (!this.holds) {
      this.canvas.style.cursor = this.over(event) < 0 ? "" : "grab";
      return;
    }
    if (event.pointerId !== this.held.pointer) return;
    this.canvas.style.cursor = "grabbing";
    const { thing, offset } = this.held, hit = this.hit(event);
    if (!hit) return;
    const place = add(hit, offset);
    this.asked = this.held.at = { thing, place: thing.low ? clipped(place, thing.low, thing.high) : place };
  }

  release(event) {
    if (!this.holds || event.pointerId !== this.held.pointer) return;
    this.held = null;
    this.canvas.style.cursor = "";
    this.view.controls.enabled = true;
  }

  /** Draw a ring where the goal is taken, also behind the arm, in the colour of one that is `reached`. */
  mark(reached) {
    const [goal] = this.things(), box = this.canvas.getBoundingClientRect();
    this.ring.hidden = !goal;
    if (!goal) return;
    const [x, y] = this.onScreen(goal.position);
    this.ring.style.transform = `translate(${x - box.left}px, ${y - box.top}px)`;
    this.ring.className = `${reached ? "reached" : ""} ${this.holds ? "held" : ""}`;
  }

  /** Number of what a pointer is over, of several that which is taken in the smallest circle; -1 where there is nothing. */
  over(event) {
    const grips = this.things().map(({ position, radius }) => {
      const [x, y, scale] = this.onScreen(position);
      const grip = clip(radius * scale, GRIP[event.pointerType] ?? GRIP.mouse, LARGEST_GRIP);
      return Math.hypot(event.clientX - x, event.clientY - y) <= grip ? grip : Infinity;
    });
    const smallest = Math.min(...grips);
    return smallest < Infinity ? grips.lastIndexOf(smallest) : -1;
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
