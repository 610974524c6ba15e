/** Colour of the page behind the scene. */
const BACKGROUND = 0xf4f6f9;

/** Where the graphics are computed in software, as the browser calls that: pictures are drawn without smooth edges. */
const SOFTWARE = /swiftshader|llvmpipe|software|basic render/i;

/** Mean time between pictures [ms], of so many, above which the scene becomes simpler. */
const SLOW = 42, PICTURES = 12;

/** Longest time that counts between two pictures [ms]: a page that is hidden draws none. */
const LONGEST = 100;

/** Pixels of the drawing for one of the page, at most. Less than one take longer: the page has to enlarge them. */
const FINEST = 2;

/** Between two arms [sizes of the workspace]. */
const BETWEEN = 0.25;

/** Draws arms beside each other with three.js. */
class Drawing {
  /** A drawing on a canvas, of marks in these colours and lengths; empty until arms are shown. */
  constructor(canvas, marks) {
    this.marks = marks;
    // Opaque: what lies below it need not be mixed in.
    const context = canvas.getContext("webgl2", { antialias: !inSoftware(), stencil: true, alpha: false });
    if (!context) throw new Error("the browser does not draw in three dimensions (WebGL 2)");
    this.renderer = new THREE.WebGLRenderer({ canvas, context });
    canvas.addEventListener("webglcontextrestored", () => this.renderer.setClearColor(BACKGROUND));
    this.renderer.setClearColor(BACKGROUND);
    this.camera = new THREE.PerspectiveCamera();
    this.camera.up.set(0, 0, 1);
    this.ratio = Math.min(window.devicePixelRatio, FINEST);
    Object.assign(this, { simple: false, spent: 0, pictures: 0, arms: [], shapes: [] });
  }

  /** Show so many arms of a run in place of others: what the page holds of it, and its meshes by `geometries`. */
  show(scene, run, shapes, count) {
    for (const { group } of this.arms) {
      group.traverse(({ geometry, material }) => {
        if (!this.shapes.includes(geometry)) geometry?.dispose();
        material?.dispose();
      });
    }
    Object.assign(this, { scene: new THREE.Scene(), shown: scene, shapes });
    const columns = Math.ceil(Math.sqrt(count)), [x, y] = [0, 1].map((axis) => extent(scene.points, axis) + BETWEEN * scene.scale);
    const places = Array.from({ length: count }, (_, i) => [-x * Math.floor(i / columns), y * (i % columns), 0]);
    this.arms = places.map((place) => new Arm(scene, run, shapes, this.marks, place));
    this.scene.add(...this.arms.map(({ group }) => group));
    if (this.simple) this.simplify();
    /** Points `[3]` m that have to be in view. */
    this.points = places.flatMap((place) => scene.points.map((point) => add(point, place)));
  }

  /** Draw the moments of as many players. */
  draw(players) {
    players.forEach((player, i) => this.arms[i].draw(player));
    this.renderer.render(this.scene, this.camera);
  }

  /** Fit the picture to its place on the page; true where that has changed. */
  fit() {
    const { clientWidth: width, clientHeight: height } = this.renderer.domElement.parentElement;
    if (this.width === width && this.height === height) return false;
    Object.assign(this, { width, height });
    this.renderer.setPixelRatio(this.ratio);
    this.renderer.setSize(width, height);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    return true;
  }

  /** Draw no shadows, and fewer triangles. */
  simplify() {
    this.simple = true;
    this.arms.forEach((arm) => arm.simplify());
    this.shapes.forEach((geometry) => simplify(geometry, this.shown.scale));
  }

  /** Draw more simply where pictures take long, as without a graphics card: first that, then fewer pixels. */
  keepPace(now) {
    this.spent += Math.min(now - (this.drawn ?? now), LONGEST);
    this.drawn = now;
    this.pictures++;
    if (this.pictures < PICTURES) return;
    const mean = this.spent / this.pictures;
    Object.assign(this, { spent: 0, pictures: 0 });
    if (mean < SLOW) return;
    if (!this.simple) {
      this.simplify();
    } else if (this.ratio > 1) {
      this.ratio = Math.max(1, 0.7 * this.ratio);
      this.width = 0;
    }
  }
}

/** Whether the browser has no graphics card to draw with. */
function inSoftware() {
  const asked = document.createElement("canvas").getContext("webgl2");
  const told = asked?.getExtension("WEBGL_debug_renderer_info");
  const name = told ? asked.getParameter(told.UNMASKED_RENDERER_WEBGL) : asked?.getParameter(asked.RENDERER);
  asked?.getExtension("WEBGL_lose_context")?.loseContext();
  return SOFTWARE.test(name);
}

/** How far points `[3]` reach along an axis. */
function extent(points, axis) {
  const places = points.map((point) => point[axis]);
  return Math.max(...places) - Math.min(...places);
}
