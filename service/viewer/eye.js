// The camera: where it looks from, how it is turned, moved and fitted, and its place as a text.

import { OrbitControls, PerspectiveCamera, Spherical, Vector3 } from "./vendor/three.js";

export const FIELD = 40; // degrees
const MARGIN = 0.9; // the share of the free picture that a fitted cloud fills
export const BAR = 56; // pixels of the picture under the bar at its top
const FITTINGS = 5; // steps that bring the picture into the middle
const DEGREES = 180 / Math.PI;

export class Eye {
  /** `moved` is called at every change. */
  constructor(canvas, moved) {
    this.camera = new PerspectiveCamera(FIELD, 1, 0.01, 100);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.addEventListener("start", () => (this.touched = true));
    this.controls.addEventListener("change", moved);
    this.touched = false; // whether someone turned or moved it since it was fitted
    this.direction = new Vector3(0, 0, 1); // of the first view
    this.fit = 1; // the distance from which all is seen
  }

  /** Take on a cloud: points of it and the first direction in the world, its radius, and its farthest point. */
  see({ points, direction, radius, reach }) {
    Object.assign(this, { points, direction, radius, reach });
    this.controls.minDistance = radius / 200;
    this.controls.maxDistance = reach * 20;
  }

  /** Return { distance, target } from where all points fill a viewport, and their picture lies in its middle. */
  fitting({ width, height }) {
    const tall = Math.tan(FIELD / DEGREES / 2);
    const free = [MARGIN * tall * (width / height), MARGIN * tall * (1 - BAR / height)];
    const right = new Vector3(this.direction.z, 0, -this.direction.x);
    if (right.length() < 1e-3) right.set(1, 0, 0);
    right.normalize();
    const axes = [right, this.direction.clone().cross(right)];
    const seen = this.points.map((at) => [...axes.map((axis) => at.dot(axis)), at.dot(this.direction)]);
    const middle = [0, 0];
    let distance = this.radius / 50;
    for (let step = 0; step < FITTINGS; step++) {
      distance = this.radius / 50;
      for (const [x, y, near] of seen) {
        const sides = [Math.abs(x - middle[0]) / free[0], Math.abs(y - middle[1]) / free[1]];
        distance = Math.max(distance, near + Math.max(...sides));
      }
      for (const side of step < FITTINGS - 1 ? [0, 1] : []) {
        const slopes = seen.map((at) => (at[side] - middle[side]) / (distance - at[2]));
        const [low, high] = [slopes.reduce((a, b) => Math.min(a, b)), slopes.reduce((a, b) => Math.max(a, b))];
        middle[side] += ((low + high) / 2) * distance;
      }
    }
    const target = axes[0].clone().multiplyScalar(middle[0]).addScaledVector(axes[1], middle[1]);
    return { distance, target };
  }

  /** Look from the first direction at all of it. */
  reset(viewport) {
    const { distance, target } = this.fitting(viewport);
    this.fit = distance;
    this.shape = [viewport.width, viewport.height];
    this.controls.target.copy(target);
    this.camera.position.copy(target).addScaledVector(this.direction, distance);
    this.controls.update();
    this.touched = false;
  }

  /** Follow a change of the viewport: what filled the old one fills the new one. */
  refit(viewport) {
    if (viewport.width === this.shape[0] && viewport.height === this.shape[1]) return;
    if (!this.touched) return this.reset(viewport);
    const { distance } = this.fitting(viewport);
    this.camera.position.sub(this.controls.target).multiplyScalar(distance / this.fit).add(this.controls.target);
    this.fit = distance;
    this.shape = [viewport.width, viewport.height];
    this.controls.update();
  }

  /** Turn about the target by angles in radians. */
  turn(right, up) {
    const offset = this.offset();
    offset.theta += right;
    offset.phi += up;
    this.place(offset);
  }

  /** Move sideways and up, in shares of the distance. */
  move(right, up) {
    const { camera, controls } = this;
    const step = camera.position.distanceTo(controls.target);
    const shift = new Vector3().setFromMatrixColumn(camera.matrix, 0).multiplyScalar(right * step);
    shift.add(new Vector3().setFromMatrixColumn(camera.matrix, 1).multiplyScalar(up * step));
    controls.target.add(shift);
    camera.position.add(shift);
    this.touched = true;
    controls.update();
  }

  /** Come closer by a factor. */
  zoom(factor) {
    const offset = this.offset();
    offset.radius /= factor;
    this.place(offset);
  }

  offset() {
    return new Spherical().setFromVector3(this.camera.position.clone().sub(this.controls.target));
  }

  place(offset) {
    this.camera.position.copy(this.controls.target).add(new Vector3().setFromSpherical(offset.makeSafe()));
    this.touched = true;
    this.controls.update();
  }

  /** Six numbers: azimuth and polar angle in degrees, distance in shares of the fitting one, target in radii. */
  get text() {
    if (!this.touched) return "";
    const { theta, phi, radius } = this.offset();
    const target = this.controls.target.toArray().map((value) => value / this.radius);
    return [theta * DEGREES, phi * DEGREES, radius / this.fit, ...target].map((value) => +value.toFixed(4)).join(",");
  }

  set text(text) {
    const numbers = text.split(",").map(Number);
    if (numbers.length !== 6 || !numbers.every(Number.isFinite) || numbers[2] <= 0) return;
    const [theta, phi, share, ...target] = numbers;
    this.controls.target.fromArray(target.map((value) => value * this.radius));
    this.place(new Spherical(share * this.fit, phi / DEGREES, theta / DEGREES));
  }

  /** Let the depths of a drawing be those of the cloud. */
  focus() {
    const distance = this.camera.position.length();
    this.camera.far = distance + this.reach * 1.1;
    this.camera.near = Math.max(this.camera.far / 5000, Math.min(distance - this.reach, distance) * 0.9);
  }

  /** Point the camera at one viewport; `barred` says whether the bar lies on it. */
  frame({ width, height }, barred) {
    this.camera.aspect = width / height;
    this.camera.setViewOffset(width, height, 0, barred ? -BAR / 2 : 0, width, height);
  }
}
