/** What is beside the arm, as it is drawn: obstacles, and objects, which are the last of the bodies. */
class BodyMeshes {
  /** None yet; they are added to a group with their shadows in another. */
  constructor(group, shadows, marks, objects) {
    Object.assign(this, { group, shadows, marks, objects, meshes: [] });
  }

  /** Show the bodies of a state; their shapes are made anew where they have changed. */
  draw({ bodies_position: positions, bodies_quaternion: quaternions, bodies_size: sizes, bodies_kind: kinds }) {
    (kinds ?? []).forEach((kind, k) => {
      const size = row(sizes, k, 3), place = row(positions, k, 3), [w, x, y, z] = row(quaternions, k, 4);
      const mesh = this.mesh(k, kind, size, k >= kinds.length - this.objects);
      mesh.position.set(...place);
      mesh.quaternion.set(x, y, z, w);
      mesh.updateMatrix();
      mesh.visible = mesh.shadow.visible = place[2] > ABSENT;
    });
  }

  mesh(k, kind, size, moves) {
    const shape = `${kind} ${size}`, { meshes, group, shadows, marks } = this;
    if (meshes[k]?.shape === shape) return meshes[k];
    if (meshes[k]) {
      const { shadow, geometry, material } = meshes[k];
      group.remove(meshes[k]);
      shadows.remove(shadow);
      for (const one of [geometry, material, shadow.children[0].material]) one.dispose();
    }
    const geometry = shapeOf(kind, size), shadow = new THREE.Group();
    const clear = kind === BOX && !moves;
    const mesh = new THREE.Mesh(geometry, shaded(moves ? marks.object : marks.fixed, clear ? marks.glass : 1));
    Object.assign(shadow, { matrixAutoUpdate: false, matrix: mesh.matrix });
    shadow.add(Object.assign(new THREE.Mesh(geometry, SHADOW()), { renderOrder: 1 }));
    group.add(mesh);
    shadows.add(shadow);
    return (meshes[k] = Object.assign(mesh, { shape, shadow, matrixAutoUpdate: false }));
  }
}

/** Height below which a body is not there [m]. */
const ABSENT = -5;

/** Geometry of a body by the number of its kind, see `Bodies` in Python; three.js has cylinders along y, not z. */
function shapeOf(kind, [x, y, z]) {
  if (kind === 2) return new THREE.SphereGeometry(x, SIDES, SIDES / 2);
  if (kind === BOX) return new THREE.BoxGeometry(2 * x, 2 * y, 2 * z);
  const round = kind === 3 ? new THREE.CapsuleGeometry(x, 2 * y, SIDES / 4, SIDES) : new THREE.CylinderGeometry(x, x, 2 * z, SIDES);
  return round.rotateX(Math.PI / 2);
}
