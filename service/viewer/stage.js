// The picture: both clouds under one camera, drawn when something changes.

import {
  BufferAttribute, BufferGeometry, Group, OrbitControls, PerspectiveCamera, Points, Scene, ShaderMaterial, Spherical,
  Vector3, WebGLRenderer,
} from "./vendor/three.js";

const VERTEX = `
  const vec3 light = vec3(-0.30, 0.42, 0.857);
  uniform float size; uniform float least; uniform float ambient; uniform vec4 flat_tint;
  attribute vec4 tint; attribute vec4 direction; varying vec3 colour;
  void main() {
    vec4 eye = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * eye;
    gl_PointSize = clamp(size / -eye.z, least, 96.0);
    float facing = abs(dot(normalize(normalMatrix * direction.xyz + 1e-6), light));
    colour = mix(tint.rgb, flat_tint.rgb, flat_tint.a) * mix(1.0, facing, 1.0 - ambient);
  }`;
const FRAGMENT = `
  uniform float opacity; varying vec3 colour;
  void main() {
    vec2 from = gl_PointCoord - 0.5;
    if (dot(from, from) > 0.25) discard;
    gl_FragColor = vec4(colour, opacity);
  }`;
const LIT = 0.28; // the share of light from everywhere
const OVERLAY = { tint: [0.96, 0.56, 0.12, 1], opacity: 0.45, size: 0.7 };
const FIELD = 40; // degrees
const DIRECTION = new Vector3(0.95, 0.72, 0.9).normalize();
const MARGIN = 0.9; // the share of the free picture that a fitted cloud fills
const BAR = 56; // pixels of the picture under the bar at its top
const SLOW_MS = 45, QUICK_MS = 24, FEWEST = 60_000, REST_MS = 160;

export class Stage {
  /** Raises an Error where the browser has no WebGL. */
  constructor(canvas, background) {
    this.canvas = canvas;
    this.background = background; // a function to the colour behind the points
    this.renderer = new WebGLRenderer({ canvas, antialias: true });
    this.scene = new Scene();
    this.world = new Group();
    this.scene.add(this.world);
    this.camera = new PerspectiveCamera(FIELD, 1, 0.01, 100);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("change", () => this.moved());
    this.view = "split";
    this.shown = "after";
    this.split = 0.5;
    this.factor = 1;
    this.lit = true;
    this.up = "z";
    this.clouds = {};
    this.budget = Infinity;
    new ResizeObserver(() => this.draw()).observe(canvas);
    canvas.addEventListener("webglcontextrestored", () => this.draw());
  }

  /** Show a display file in place of the last one. */
  load(display) {
    this.clear();
    this.count = display.shown;
    const [low, high] = display.box.map((corner) => new Vector3(...corner));
    this.corners = [0, 1, 2, 3, 4, 5, 6, 7].map((bits) =>
      new Vector3(...["x", "y", "z"].map((axis, index) => (bits & (1 << index) ? high : low)[axis])));
    this.radius = Math.max(low.distanceTo(high) / 2, 1e-9);
    this.spacing = (this.radius * 3.6) / Math.sqrt(this.count);
    for (const name of ["before", "after"]) {
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(display[name].POSITION, 3));
      geometry.setAttribute("direction", new BufferAttribute(display[name].NORMAL, 4, true));
      geometry.computeBoundingSphere();
      const material = new ShaderMaterial({
        vertexShader: VERTEX,
        fragmentShader: FRAGMENT,
        uniforms: {
          size: { value: 1 }, least: { value: 1 }, ambient: { value: LIT }, opacity: { value: 1 },
          flat_tint: { value: [0, 0, 0, 0] },
        },
      });
      const cloud = new Points(geometry, material);
      cloud.frustumCulled = false;
      this.clouds[name] = cloud;
      this.world.add(cloud);
    }
    this.reach = Math.max(...Object.values(this.clouds).map(({ geometry: { boundingSphere: ball } }) =>
      ball.center.length() + ball.radius));
    this.turnUp(this.up);
  }

  clear() {
    for (const cloud of Object.values(this.clouds)) {
      this.world.remove(cloud);
      cloud.geometry.dispose();
      cloud.material.dispose();
    }
    this.clouds = {};
  }

  colour({ before, after, lit }) {
    this.lit = lit;
    this.clouds.before.geometry.setAttribute("tint", new BufferAttribute(before, 4, true));
    this.clouds.after.geometry.setAttribute("tint", new BufferAttribute(after, 4, true));
    this.draw();
  }

  set(values) {
    Object.assign(this, values);
    this.controls.zoomToCursor = this.view !== "side"; // two panes: the cursor is not where the camera thinks
    this.draw();
  }

  /** Which axis of the file points up; three.js has Y up. */
  turnUp(up) {
    this.up = up;
    this.world.rotation.x = up === "z" ? -Math.PI / 2 : 0;
    this.reset();
  }

  /** Fit the box of 1 to 99 per cent. */
  reset() {
    if (!this.clouds.after) return;
    const { width, height } = this.size();
    const { viewport } = this.panes(width, height)[0];
    const tall = Math.tan((FIELD * Math.PI) / 360);
    const free = [MARGIN * tall * (viewport.width / viewport.height), MARGIN * tall * (1 - BAR / viewport.height)];
    const right = new Vector3(DIRECTION.z, 0, -DIRECTION.x).normalize();
    const above = DIRECTION.clone().cross(right);
    this.world.updateMatrixWorld();
    const distances = this.corners.map((corner) => {
      const at = corner.clone().applyMatrix4(this.world.matrixWorld);
      const sides = [Math.abs(at.dot(right)) / free[0], Math.abs(at.dot(above)) / free[1]];
      return at.dot(DIRECTION) + Math.max(...sides);
    });
    this.controls.target.set(0, 0, 0);
    this.camera.position.copy(DIRECTION).multiplyScalar(Math.max(...distances, this.radius / 50));
    this.controls.minDistance = this.radius / 200;
    this.controls.maxDistance = this.reach * 20;
    this.controls.update();
    this.draw();
  }

  /** Turn about the target by angles in radians. */
  turn(right, up) {
    const { camera, controls } = this;
    const offset = new Spherical().setFromVector3(camera.position.clone().sub(controls.target));
    offset.theta += right;
    offset.phi += up;
    camera.position.copy(controls.target).add(new Vector3().setFromSpherical(offset.makeSafe()));
    controls.update();
  }

  /** Move sideways and up, in shares of the distance. */
  move(right, up) {
    const { camera, controls } = this;
    const step = camera.position.distanceTo(controls.target);
    const shift = new Vector3().setFromMatrixColumn(camera.matrix, 0).multiplyScalar(right * step);
    shift.add(new Vector3().setFromMatrixColumn(camera.matrix, 1).multiplyScalar(up * step));
    controls.target.add(shift);
    camera.position.add(shift);
    controls.update();
  }

  /** Come closer by a factor. */
  zoom(factor) {
    const { camera, controls } = this;
    camera.position.sub(controls.target).multiplyScalar(1 / factor).add(controls.target);
    controls.update();
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
    this.rest = setTimeout(() => this.draw(), REST_MS);
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

  /** Where each cloud is drawn: viewport and scissor in CSS pixels from the lower left, and the aspect of the camera. */
  panes(width, height) {
    const whole = { x: 0, y: 0, width, height };
    const pane = (names, viewport, scissor = viewport) =>
      ({ names, viewport, scissor, aspect: viewport.width / viewport.height });
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
    const { renderer, camera, clouds } = this;
    renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    renderer.setSize(width, height, false);
    renderer.setClearColor(this.background());
    renderer.setScissorTest(false);
    renderer.clear();
    if (!clouds.after) return;
    const distance = camera.position.length();
    camera.far = distance + this.reach * 1.1;
    camera.near = Math.max(camera.far / 5000, Math.min(distance - this.reach, distance) * 0.9);
    renderer.setScissorTest(true);
    for (const { names, viewport, scissor, aspect } of this.panes(width, height)) {
      if (scissor.width <= 0 || scissor.height <= 0) continue;
      camera.aspect = aspect;
      const lower = viewport.y + viewport.height < height; // this pane is not under the bar
      camera.setViewOffset(viewport.width, viewport.height, 0, lower ? 0 : -BAR / 2, viewport.width, viewport.height);
      renderer.setViewport(viewport.x, viewport.y, viewport.width, viewport.height);
      renderer.setScissor(scissor.x, scissor.y, scissor.width, scissor.height);
      for (const [name, cloud] of Object.entries(clouds)) {
        cloud.visible = names.includes(name);
        this.prepare(cloud, viewport.height, name === "before" && this.view === "overlay");
      }
      renderer.render(this.scene, camera);
    }
    this.drawnAt = performance.now();
    this.canvas.dataset.drawn = Math.min(this.most, this.count);
  }

  prepare(cloud, height, over) {
    const ratio = this.renderer.getPixelRatio();
    const { uniforms } = cloud.material;
    const drawn = Math.min(Math.round(this.most), this.count);
    const wider = Math.sqrt(this.count / drawn); // fewer points, each larger
    const pixels = (height * ratio) / (2 * Math.tan((FIELD * Math.PI) / 360));
    uniforms.size.value = this.spacing * this.factor * wider * pixels * (over ? OVERLAY.size : 1);
    uniforms.least.value = 1.2 * ratio;
    uniforms.ambient.value = this.lit && !over ? LIT : 1;
    uniforms.flat_tint.value = over ? OVERLAY.tint : [0, 0, 0, 0];
    uniforms.opacity.value = over ? OVERLAY.opacity : 1;
    cloud.material.transparent = over;
    cloud.material.depthWrite = !over;
    cloud.renderOrder = over ? 1 : 0;
    cloud.geometry.setDrawRange(0, drawn);
  }

  /** Return the picture as a PNG. */
  picture() {
    this.most = Infinity;
    this.render();
    return new Promise((resolve) => this.canvas.toBlob(resolve, "image/png"));
  }
}
