// The display file of a job: a binary glTF with the meshes `before` and `after`. See docs/api.md.

const JSON_CHUNK = 0x4e4f534a;
const TYPES = { 5120: Int8Array, 5121: Uint8Array, 5126: Float32Array };

/** Return { points, shown, box, displacement, before, after } of the bytes; each mesh maps attributes to arrays. */
export function parse(buffer) {
  const head = new DataView(buffer);
  if (head.getUint32(12 + 4, true) !== JSON_CHUNK) throw new Error("not a display file");
  const length = head.getUint32(12, true);
  const document = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 20, length)));
  const start = 20 + length + 8;

  const meshes = {};
  for (const { name, primitives } of document.meshes) {
    meshes[name] = {};
    for (const [attribute, index] of Object.entries(primitives[0].attributes)) {
      const { bufferView, componentType } = document.accessors[index];
      const view = document.bufferViews[bufferView];
      const Type = TYPES[componentType];
      meshes[name][attribute] = new Type(buffer, start + view.byteOffset, view.byteLength / Type.BYTES_PER_ELEMENT);
    }
  }
  return { ...document.asset.extras, shown: meshes.after._DISPLACEMENT.length, ...meshes };
}
