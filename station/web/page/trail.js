// The way of the root on the floor: a ribbon that fades with its age in steps.
import * as THREE from "./vendor/three.js";
import { trailMaterial } from "./materials.js";

const MOST = 400, STEP_M = 0.03, JUMP_M = 0.6, HALF_WIDTH_M = 0.012;

export class Trail {
  constructor() {
    /** @type {[number, number][]} */
    this.points = [];
    const geometry = new THREE.BufferGeometry();
    this.corners = new Float32Array(MOST * 6);
    this.ages = new Float32Array(MOST * 2);
    geometry.setAttribute("position", new THREE.BufferAttribute(this.corners, 3).setUsage(THREE.DynamicDrawUsage));
    geometry.setAttribute("fade", new THREE.BufferAttribute(this.ages, 1).setUsage(THREE.DynamicDrawUsage));
    const index = [];
    for (let i = 0; i + 1 < MOST; i += 1) index.push(2 * i, 2 * i + 1, 2 * i + 2, 2 * i + 1, 2 * i + 3, 2 * i + 2);
    geometry.setIndex(index);
    geometry.setDrawRange(0, 0);
    this.mesh = new THREE.Mesh(geometry, trailMaterial());
    this.mesh.frustumCulled = false;
    this.mesh.renderOrder = -1;
    this.is_new = false;
  }

  clear() { this.points = []; this.is_new = true; }

  /** @param {number} x @param {number} y */
  add(x, y) {
    const last = this.points.at(-1);
    const far = last ? Math.hypot(x - last[0], y - last[1]) : Infinity;
    if (far < STEP_M) return;
    if (far > JUMP_M) this.points = [];  // it was set down elsewhere; that was no way
    this.points.push([x, y]);
    if (this.points.length > MOST) this.points.shift();
    this.is_new = true;
  }

  update() {
    if (!this.is_new) return;
    this.is_new = false;
    const { points } = this, count = points.length;
    for (let i = 0; i < count; i += 1) {
      const [x, y] = points[i], [ax, ay] = points[Math.max(0, i - 1)], [bx, by] = points[Math.min(count - 1, i + 1)];
      const length = Math.hypot(bx - ax, by - ay) || 1, nx = (-(by - ay) / length) * HALF_WIDTH_M, ny = ((bx - ax) / length) * HALF_WIDTH_M;
      this.corners.set([x + nx, y + ny, 0.006, x - nx, y - ny, 0.006], 6 * i);
      this.ages[2 * i] = this.ages[2 * i + 1] = (i + 1) / count;
    }
    const { geometry } = this.mesh;
    geometry.setDrawRange(0, Math.max(0, (count - 1) * 6));
    geometry.attributes.position.needsUpdate = true;
    geometry.attributes.fade.needsUpdate = true;
  }
}
