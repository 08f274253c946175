// The picture: both clouds under one camera, drawn when something changes.

import { Group, Scene, Vector3, WebGLRenderer } from "./vendor/three.js";
import { Eye, FIELD } from "./eye.js";
import { AXES, firstView, sideFor } from "./first_view.js";
import { spacings } from "./spacing.js";
import { dispose, makeSplats, prepare, tint } from "./splats.js";

const FITTED = 4000; // points that decide what a fitted picture shows
const SLOW_MS = 45, QUICK_MS = 24, FEWEST = 60_000, REST_MS = 160;

/** Return points of a display file that lie in its box; the box's ends where none does. */
function sample({ after, box: [low, high] }) {
  const points = [];
  for (let at = 0; at < Math.min(after.POSITION.length, 3 * FITTED); at += 3) {
    const point = after.POSITION.subarray(at, at + 3);
    if (point.every((value, axis) => value >= low[axis] && value <= high[axis])) points.push(new Vector3(...point));
  }
  return points.length ? points : [new Vector3(...low), new Vector3(...high)];
}

export class Stage {
  /** Raises an Error where the browser has no WebGL. */
  constructor(canvas, background) {
    this.canvas = canvas;
    this.background = background; // a function to the colour behind the points
    this.renderer = new WebGLRenderer({ canvas, antialias: true });
    this.scene = new Scene();
    this.world = new Group();
    this.scene.add(this.world);
    this.eye = new Eye(canvas, () => this.moved());
    this.rested = () => {}; // called when the camera has come to rest
    this.view = "split";
    this.shown = "after";
    this.split = 0.5;
    this.factor = 1;
    this.lit = true;
    this.up = "z";
    this.clouds = {};
    this.budget = Infinity;
    new ResizeObserver(() => this.refit()).observe(canvas);
    canvas.addEventListener("webglcontextrestored", () => this.draw());
  }

  /** Show a display file in place of the last one, from where most of it is seen. */
  load(display) {
    this.clear();
    this.count = display.shown;
    const [low, high] = display.box.map((corner) => new Vector3(...corner));
    this.fitted = sample(display);
    this.radius = Math.max(low.distanceTo(high) / 2, 1e-9);
    const spacing = spacings(display.after.POSITION);
    for (const name of ["before", "after"]) {
      this.clouds[name] = makeSplats(display[name], spacing);
      this.world.add(this.clouds[name]);
    }
    this.reach = Math.max(...Object.values(this.clouds).map(({ geometry: { boundingSphere: ball } }) =>
      ball.center.length() + ball.radius));
    this.display = display;
    this.first = firstView(display);
    this.turnUp(this.first.up);
  }

  clear() {
    for (const cloud of Object.values(this.clouds)) {
      this.world.remove(cloud);
      dispose(cloud);
    }
    this.clouds = {};
  }

  colour({ before, after, lit }) {
    this.lit = lit;
    tint(this.clouds.before, before);
    tint(this.clouds.after, after);
    this.draw();
  }

  set(values) {
    Object.assign(this, values);
    this.eye.controls.zoomToCursor = this.view !== "side"; // two panes: the cursor is not where the camera thinks
    this.refit();
  }

  /** Which axis of the file points up, a key of AXES; three.js has Y up. */
  turnUp(up) {
    this.up = up;
    const direction = up === this.first.up ? this.first.direction : sideFor(this.display, up);
    this.world.quaternion.setFromUnitVectors(new Vector3(...AXES[up]), new Vector3(0, 1, 0));
    this.world.updateMatrixWorld();
    const { matrixWorld } = this.world;
    this.eye.see({
      points: this.fitted.map((point) => point.clone().applyMatrix4(matrixWorld)),
      direction: new Vector3(...direction).transformDirection(matrixWorld),
      radius: this.radius,
      reach: this.reach,
    });
    this.reset();
  }

  /** Fit the box of 1 to 99 per cent. */
  reset() {
    if (!this.clouds.after) return;
    this.eye.reset(this.pane());
    this.draw();
  }

  /** Let what filled the picture fill it again after a change of its shape. */
  refit() {
    if (this.clouds.after) this.eye.refit(this.pane());
    this.draw();
  }

  /** The viewport of the first pane. */
  pane() {
    const { width, height } = this.size();
    return this.panes(width, height)[0].viewport;
  }

  /** While the camera moves, draw as many points as the machine draws smoothly; all of them once it rests. */
  moved() {
    const now = performance.now();
    const since = now - (this.movedAt ?? 0);
    this.movedAt = now;
    if (since < 1000 && this.drawnAt > now - since) {
      const drawn = Math.min(this.budget, this.count ?? Infinity);
      if (since > SLOW_MS) this.budget = Math.max(FEWEST, drawn * 0.6);
      else if (since < QUICK_MS) this.budget = Math.max(FEWEST, drawn * 1.3);
    }
    this.draw(this.budget);
    clearTimeout(this.rest);
    this.rest = setTimeout(() => {
      this.draw();
      this.rested();
    }, REST_MS);
  }

  /** Draw with the next frame, at most `most` points of each cloud. */
  draw(most = Infinity) {
    this.most = most;
    this.frame ??= requestAnimationFrame(() => {
      this.frame = null;
      this.render();
    });
  }

  size() {
    return { width: this.canvas.clientWidth || 1, height: this.canvas.clientHeight || 1 };
  }

  /** Where each cloud is drawn: viewport and scissor in CSS pixels from the lower left. */
  panes(width, height) {
    const whole = { x: 0, y: 0, width, height };
    const pane = (names, viewport, scissor = viewport) => ({ names, viewport, scissor });
    if (this.view === "side") {
      if (width < height) {
        const half = height / 2;
        return [pane(["before"], { ...whole, y: half, height: half }), pane(["after"], { ...whole, height: half })];
      }
      const half = width / 2;
      return [pane(["before"], { ...whole, width: half }), pane(["after"], { ...whole, x: half, width: half })];
    }
    if (this.view === "overlay") return [pane(["after", "before"], whole)];
    if (this.view === "flip") return [pane([this.shown], whole)];
    const at = Math.round(this.split * width);
    return [
      pane(["before"], whole, { ...whole, width: at }),
      pane(["after"], whole, { ...whole, x: at, width: width - at }),
    ];
  }

  render() {
    const { width, height } = this.size();
    const { renderer, eye, clouds } = this;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    renderer.setSize(width, height, false);
    renderer.setClearColor(this.background());
    renderer.setScissorTest(false);
    renderer.clear();
    if (!clouds.after) return;
    eye.focus();
    renderer.setScissorTest(true);
    for (const { names, viewport, scissor } of this.panes(width, height)) {
      if (scissor.width <= 0 || scissor.height <= 0) continue;
      eye.frame(viewport, viewport.y + viewport.height >= height);
      renderer.setViewport(viewport.x, viewport.y, viewport.width, viewport.height);
      renderer.setScissor(scissor.x, scissor.y, scissor.width, scissor.height);
      for (const [name, cloud] of Object.entries(clouds)) {
        cloud.visible = names.includes(name);
        this.prepare(cloud, viewport.height, name === "before" && this.view === "overlay");
      }
      renderer.render(this.scene, eye.camera);
    }
    this.drawnAt = performance.now();
    this.canvas.dataset.drawn = Math.min(this.most, this.count);
  }

  prepare(cloud, height, over) {
    const ratio = this.renderer.getPixelRatio();
    const drawn = Math.min(Math.round(this.most), this.count);
    const wider = Math.sqrt(this.count / drawn); // fewer points, each larger
    const pixels = (height * ratio) / (2 * Math.tan((FIELD * Math.PI) / 360));
    prepare(cloud, { pixels, ratio, factor: this.factor * wider, drawn, lit: this.lit, over });
  }

  /** Return the picture as a PNG. */
  picture() {
    this.most = Infinity;
    this.render();
    return new Promise((resolve) => this.canvas.toBlob(resolve, "image/png"));
  }
}
