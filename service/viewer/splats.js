// The points of a cloud as small discs that lie on the surface, lit from the camera's side.

import { BufferAttribute, BufferGeometry, Points, ShaderMaterial } from "./vendor/three.js";

// The side of a normal is unknown until something orients it, so the side that faces the camera is the lit one.
const VERTEX = `
  const vec3 light = vec3(-0.35, 0.45, 0.82);
  uniform float size; uniform float least; uniform float ambient; uniform vec4 flat_tint;
  attribute vec4 tint; attribute vec4 direction; attribute float spacing;
  varying vec3 colour; varying vec3 outward; varying float tilted;
  void main() {
    vec4 eye = modelViewMatrix * vec4(position, 1.0);
    gl_Position = projectionMatrix * eye;
    gl_PointSize = clamp(size * spacing / -eye.z, least, 96.0);
    outward = normalize(normalMatrix * direction.xyz + 1e-6);
    if (dot(outward, eye.xyz) > 0.0) outward = -outward;
    tilted = gl_PointSize > 3.0 * least ? 1.0 : 0.0;
    float facing = 0.5 + 0.5 * dot(outward, light);
    colour = mix(tint.rgb, flat_tint.rgb, flat_tint.a) * mix(1.0, facing * facing, 1.0 - ambient);
  }`;
const FRAGMENT = `
  uniform float opacity; varying vec3 colour; varying vec3 outward; varying float tilted;
  void main() {
    vec2 from = vec2(gl_PointCoord.x - 0.5, 0.5 - gl_PointCoord.y);
    float deep = tilted * dot(from, outward.xy) / max(outward.z, 0.35);
    if (dot(from, from) + deep * deep > 0.25) discard;
    gl_FragColor = vec4(colour, opacity);
  }`;
const LIT = 0.12; // the share of light from everywhere
const CLOSED = 2.1; // diameters of discs, in spacings, that leave no holes
const OVERLAY = { tint: [0.96, 0.56, 0.12, 1], opacity: 0.45, size: 0.7 };

/** Return the points of one mesh of a display file, each as large as `spacing` (N) says. */
export function makeSplats({ POSITION, NORMAL }, spacing) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(POSITION, 3));
  geometry.setAttribute("direction", new BufferAttribute(NORMAL, 4, true));
  geometry.setAttribute("spacing", new BufferAttribute(spacing, 1));
  geometry.computeBoundingSphere();
  const material = new ShaderMaterial({
    vertexShader: VERTEX,
    fragmentShader: FRAGMENT,
    uniforms: {
      size: { value: 1 }, least: { value: 1 }, ambient: { value: LIT }, opacity: { value: 1 },
      flat_tint: { value: [0, 0, 0, 0] },
    },
  });
  const splats = new Points(geometry, material);
  splats.frustumCulled = false;
  return splats;
}

/** Set the colours, RGBA bytes of each point. */
export function tint(splats, bytes) {
  splats.geometry.setAttribute("tint", new BufferAttribute(bytes, 4, true));
}

/**
 * Make ready for one drawing: `pixels` of a length of 1 at a distance of 1, a `factor` of the size, the number `drawn`,
 * whether light falls on the points, and whether they lie `over` the others.
 */
export function prepare(splats, { pixels, ratio, factor, drawn, lit, over }) {
  const { uniforms } = splats.material;
  uniforms.size.value = CLOSED * factor * pixels * (over ? OVERLAY.size : 1);
  uniforms.least.value = 1.2 * ratio;
  uniforms.ambient.value = lit && !over ? LIT : 1;
  uniforms.flat_tint.value = over ? OVERLAY.tint : [0, 0, 0, 0];
  uniforms.opacity.value = over ? OVERLAY.opacity : 1;
  splats.material.transparent = over;
  splats.material.depthWrite = !over;
  splats.renderOrder = over ? 1 : 0;
  splats.geometry.setDrawRange(0, drawn);
}

/** Free what the graphics card holds of them. */
export function dispose(splats) {
  splats.geometry.dispose();
  splats.material.dispose();
}
