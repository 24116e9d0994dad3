// Where three.js has put the plants of a glTF, by row of their property table.
import { Matrix4, Vector3 } from "three";

/** Return [row, x, y, z] of each instance, once whatever the number of its meshes, in the frame of `root`. */
export function placedRows(root) {
  root.updateMatrixWorld(true);
  const toRoot = root.matrixWorld.clone().invert();
  const found = new Map();
  const matrix = new Matrix4();
  let meshes = 0;
  let triangles = 0;
  root.traverse((object) => {
    if (!object.isInstancedMesh) return;
    meshes += 1;
    triangles += (object.count * (object.geometry.index?.count ?? object.geometry.attributes.position.count)) / 3;
    const rows = object.geometry.attributes._FEATURE_ID_0;
    for (let i = 0; i < object.count; i++) {
      object.getMatrixAt(i, matrix);
      const place = new Vector3().setFromMatrixPosition(matrix.premultiply(object.matrixWorld).premultiply(toRoot));
      const row = rows.array[i * rows.itemSize];
      const before = found.get(row);
      if (before && place.distanceTo(new Vector3(...before)) > 1e-3) throw new Error(`row ${row} stands in two places`);
      found.set(row, place.toArray());
    }
  });
  return { rows: [...found].map(([row, place]) => [row, ...place]), meshes, triangles };
}

/** Return a column of text of a glTF's property table. */
export async function textColumn(parser, name) {
  const { propertyTables } = parser.json.extensions.EXT_structural_metadata;
  const { values, stringOffsets, stringOffsetType } = propertyTables[0].properties[name];
  const bytes = new Uint8Array(await parser.getDependency("bufferView", values));
  const offsetBytes = await parser.getDependency("bufferView", stringOffsets);
  const types = { UINT8: Uint8Array, UINT16: Uint16Array, UINT32: Uint32Array };
  const offsets = new types[stringOffsetType ?? "UINT32"](offsetBytes);
  const decoder = new TextDecoder("utf-8", { fatal: true });
  return Array.from({ length: propertyTables[0].count }, (_, i) => decoder.decode(bytes.subarray(offsets[i], offsets[i + 1])));
}
