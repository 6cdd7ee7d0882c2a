// Geometry of a robot: the shapes of each body in one mesh, with their colours in its corners. 85 shapes are 30 meshes.
import * as THREE from "./vendor/three.js";

const MOST_SHAPES = 2000, MOST_CORNERS = 2e6;

/** @param {any} robot @param {number} detail 1 for round shapes @returns {[number, any][]} body and its geometry */
export function robotParts(robot, detail) {
  /** @type {Map<number, any[]>} */
  const bodies = new Map();
  let corners = 0;
  for (const shape of (robot.shapes ?? []).slice(0, MOST_SHAPES)) {
    const geometry = geometryOf(shape, detail);
    if (!geometry || !Number.isInteger(shape.body)) continue;
    corners += geometry.attributes.position.count;
    if (corners > MOST_CORNERS) break;
    if (!bodies.has(shape.body)) bodies.set(shape.body, []);
    bodies.get(shape.body)?.push(geometry);
  }
  /** @type {[number, any][]} */
  const parts = [];
  for (const [body, geometries] of bodies) {
    const merged = THREE.mergeGeometries(geometries);
    if (merged) parts.push([body, merged]);
  }
  return parts;
}

/** @param {any} shape @param {number} detail */
function geometryOf(shape, detail) {
  const some = (/** @type {number} */ count) => Math.round(count * detail);
  const [a, b, c] = shape.size ?? [0, 0, 0];
  let geometry;
  if (shape.kind === "ellipsoid") geometry = new THREE.SphereGeometry(1, some(28), some(18)).scale(a, b, c);
  else if (shape.kind === "capsule") geometry = new THREE.CapsuleGeometry(a, 2 * b, some(8), some(22)).rotateX(Math.PI / 2);
  else if (shape.kind === "cylinder") geometry = new THREE.CylinderGeometry(a, a, 2 * b, some(28)).rotateX(Math.PI / 2);
  else if (shape.kind === "box") geometry = new THREE.BoxGeometry(2 * a, 2 * b, 2 * c);
  else if (shape.kind === "mesh" && shape.faces?.length) {
    geometry = new THREE.BufferGeometry();
    geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(shape.vertices), 3));
    geometry.setIndex([...shape.faces]);
    if (shape.normals?.length === shape.vertices.length) geometry.setAttribute("normal", new THREE.BufferAttribute(new Float32Array(shape.normals), 3));
    else geometry.computeVertexNormals();
  } else return null;
  geometry.deleteAttribute("uv");
  const flat = geometry.index ? geometry.toNonIndexed() : geometry;
  const [w, x, y, z] = shape.quat, [px, py, pz] = shape.pos;
  flat.applyMatrix4(new THREE.Matrix4().compose(new THREE.Vector3(px, py, pz), new THREE.Quaternion(x, y, z, w), new THREE.Vector3(1, 1, 1)));
  const [r, g, bl] = shape.rgba ?? [180, 180, 180];
  const colour = new THREE.Color().setRGB(r / 255, g / 255, bl / 255, "srgb");
  const count = flat.attributes.position.count, colours = new Float32Array(3 * count);
  for (let i = 0; i < count; i += 1) colour.toArray(colours, 3 * i);
  flat.setAttribute("color", new THREE.BufferAttribute(colours, 3));
  return flat;
}
