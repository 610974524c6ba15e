/* What is drawn of an arm: meshes by link, sent as differences of whole numbers and compressed. */

/** How far the surface of a mesh may move where it becomes simpler, in sizes of the workspace [m]. */
const COARSE = 0.0015;

/** Geometries of the `parts` of an arm, in the frame of the link of each, in metres. */
async function geometries({ parts, data }) {
  const buffer = await inflated(data);
  await THREE.MeshoptSimplifier.ready;
  let offset = 0;
  return parts.map((part) => {
    const faces = new Int32Array(buffer.slice(offset, (offset += 12 * part.faces)));
    const places = new Int16Array(buffer.slice(offset, (offset += 6 * part.vertices)));
    const geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(coordinates(part, places), 3));
    geometry.setIndex(new THREE.BufferAttribute(summed(faces, Uint32Array), 1));
    geometry.computeVertexNormals();
    return geometry;
  });
}

/** Leave out triangles of a geometry as long as its surface moves by no more than COARSE of an arm of this scale. */
function simplify(geometry, scale) {
  const { index, attributes: { position }, userData } = geometry;
  if (userData.simple || !THREE.MeshoptSimplifier.supported) return;
  const [fewer] = THREE.MeshoptSimplifier.simplify(index.array, position.array, 3, 0, COARSE * scale, ["ErrorAbsolute"]);
  geometry.setIndex(new THREE.BufferAttribute(fewer, 1));
  userData.simple = true;
}

/** Coordinates `[3 v]` m of vertices whose x, then y, then z are sent as differences of 16-bit shares of the size. */
function coordinates({ vertices, low, size }, places) {
  const numbers = new Float32Array(3 * vertices);
  for (let axis = 0; axis < 3; axis++) {
    const shares = summed(places.subarray(axis * vertices, (axis + 1) * vertices), Uint16Array);
    for (let i = 0; i < vertices; i++) numbers[3 * i + axis] = low[axis] + (size[axis] * shares[i]) / 65535;
  }
  return numbers;
}

/** Numbers whose differences are given. */
function summed(differences, Kind) {
  const numbers = new Kind(differences.length);
  for (let i = 0, sum = 0; i < numbers.length; i++) numbers[i] = sum += differences[i];
  return numbers;
}
