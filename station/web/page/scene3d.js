// The scene: a robot of plain shapes, the reference as a translucent second one, the way of its root, a floor. z is up.
import * as THREE from "./vendor/three.js";
import { ControlElement } from "./control_element.js";
import { robotParts } from "./robot_parts.js";
import { Trail } from "./trail.js";
import { floorMaterial, ghostMaterial } from "./materials.js";

const SLOW_MS = 30, AWAY_M = 1e4;
const FRAME_MS = [0, 90, 30];  // by quality; poses come at 30 Hz, and in software the processor is the stop's too

/** Whether this browser draws without a GPU. */
function isSoftware() {
  const gl = new OffscreenCanvas(1, 1).getContext("webgl2");
  if (!gl) throw new Error("it has no WebGL 2");
  const info = gl.getExtension("WEBGL_debug_renderer_info");
  const name = info ? String(gl.getParameter(info.UNMASKED_RENDERER_WEBGL)) : "";
  gl.getExtension("WEBGL_lose_context")?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

export class Scene3d {
  /**
   * @param {OffscreenCanvas} canvas
   * @param {any} colours of the theme
   * @param {(drawn: {frames: number, draw_ms: number}) => void} drawn
   */
  constructor(canvas, colours, drawn) {
    this.drawn = drawn;
    /** Software GL gets no shadows and no smooth edges; a slow GPU loses the shadows when it proves slow. */
    this.quality = isSoftware() ? 1 : 2;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: this.quality > 1, alpha: true, powerPreference: "low-power" });
    this.renderer.setClearColor(0, 0);
    this.renderer.toneMapping = THREE.NeutralToneMapping;
    this.renderer.shadowMap.enabled = this.quality > 1;
    this.renderer.shadowMap.type = THREE.PCFShadowMap;
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(34, 1, 0.05, 60);
    this.camera.up.set(0, 0, 1);
    this.element = new ControlElement();
    this.controls = new THREE.OrbitControls(this.camera, /** @type {any} */ (this.element));
    Object.assign(this.controls, { enableDamping: true, dampingFactor: 0.12, minDistance: 0.5, maxDistance: 15, maxPolarAngle: 1.62, zoomSpeed: 0.8 });
    this.controls.addEventListener("change", () => this.ask());

    this.sky = new THREE.HemisphereLight(0xffffff, 0x8090a0, 1.5);
    this.sky.position.set(0, 0, 1);
    this.sun = new THREE.DirectionalLight(0xffffff, 2.2);
    this.sun.castShadow = true;
    this.sun.shadow.mapSize.set(1024, 1024);
    this.sun.shadow.radius = 5;
    Object.assign(this.sun.shadow.camera, { left: -1.3, right: 1.3, top: 1.3, bottom: -1.3, near: 0.5, far: 8 });
    this.rim = new THREE.DirectionalLight(0x9cc4ff, 1.4);
    this.scene.add(this.sky, this.sun, this.sun.target, this.rim, this.rim.target);

    this.floor = new THREE.Mesh(new THREE.PlaneGeometry(24, 24), floorMaterial());
    this.floor.renderOrder = -2;
    this.shadow = new THREE.Mesh(new THREE.PlaneGeometry(8, 8), new THREE.ShadowMaterial({ opacity: 0.3, depthWrite: false }));
    this.shadow.receiveShadow = true;
    this.shadow.position.z = 0.002;
    this.shadow.renderOrder = -1;
    this.gate = new THREE.Mesh(new THREE.RingGeometry(0.42, 0.46, 96), new THREE.MeshBasicMaterial({ transparent: true, opacity: 0.9, depthWrite: false }));
    this.gate.position.z = 0.004;
    this.trail = new Trail();
    this.robot = new THREE.Group();
    this.scene.add(this.floor, this.shadow, this.gate, this.trail.mesh, this.robot);

    /** Materials of the robot, of its reference, and of the reference's depth. @type {any} */ this.solid = undefined;
    /** @type {any} */ this.ghost = undefined;
    /** @type {any} */ this.hole = undefined;
    this.root = new THREE.Vector3(0, 0, 0.7);
    this.yaw = 0;
    /** @type {any} */
    this.poses = null;
    this.has_root = false;
    this.frames = 0;
    this.is_asked = false;
    this.draw_ms = 0;
    this.drawn_at = -Infinity;
    this.setColours(colours);
    this.resetView();
  }

  /** @param {any} robot as `GET /api/scene` gives it */
  setRobot(robot) {
    for (const mesh of [...this.robot.children]) { this.robot.remove(mesh); /** @type {any} */ (mesh).geometry.dispose(); }
    this.floats = robot.floats !== false;
    /** @type {any[]} */ this.bodies = [];
    /** @type {any[]} */ this.ghosts = [];
    this.solid ??= new THREE.MeshStandardMaterial({ vertexColors: true, roughness: 0.5, metalness: 0.12 });
    this.hole ??= new THREE.MeshBasicMaterial({ colorWrite: false });
    for (const [body, geometry] of robotParts(robot, this.quality > 1 ? 1 : 0.55)) {
      const mesh = new THREE.Mesh(geometry, this.solid);
      mesh.castShadow = true;
      // The reference is first drawn into depth alone, so that its own inside does not shine through it.
      const hole = new THREE.Mesh(geometry, this.hole), ghost = new THREE.Mesh(geometry, this.ghost);
      hole.renderOrder = 1;
      ghost.renderOrder = 2;
      for (const each of [mesh, hole, ghost]) { each.frustumCulled = false; each.visible = false; each.matrixAutoUpdate = false; this.robot.add(each); }
      this.bodies.push([body, mesh]);
      this.ghosts.push([body, hole, ghost]);
    }
    this.trail.clear();
    this.has_root = false;
    this.poses = null;
    this.ask();
  }

  /** @param {{measured: Float32Array | null, reference: Float32Array | null, gate: string}} poses */
  setPoses(poses) {
    this.poses = poses;
    this.ask();
  }

  /** @param {[number, number][]} points the way that the root came, in place of what was known of it [m] */
  setTrail(points) {
    this.trail.clear();
    if (this.floats) for (const [x, y] of points) if (Math.abs(x) < AWAY_M && Math.abs(y) < AWAY_M) this.trail.add(x, y);
    this.ask();
  }

  place() {
    const { measured, reference, gate } = this.poses;
    const matrix = (/** @type {any} */ mesh, /** @type {Float32Array | null} */ all, /** @type {number} */ body) => {
      const at = body * 7, p = all && at + 7 <= all.length ? all.subarray(at, at + 7) : null;
      mesh.visible = p !== null && p.every((value) => Number.isFinite(value) && Math.abs(value) < AWAY_M);
      if (mesh.visible && p) mesh.matrix.compose(mesh.position.set(p[0], p[1], p[2]), mesh.quaternion.set(p[4], p[5], p[6], p[3]), mesh.scale);
    };
    for (const [body, mesh] of this.bodies ?? []) matrix(mesh, measured, body);
    for (const [body, ...meshes] of this.ghosts ?? []) for (const mesh of meshes) matrix(mesh, reference, body);
    this.gate.material.color.set(/^#[0-9a-f]{6}$/.test(gate) ? gate : "#9aa5b1");
    if (!this.is_dark) this.gate.material.color.multiplyScalar(0.62);  // a pastel would drown in a light floor
    if (!measured || !measured.subarray(0, 3).every((value) => Number.isFinite(value) && Math.abs(value) < AWAY_M)) return;
    const [x, y, z] = measured;
    if (this.floats) this.trail.add(x, y);
    // The view goes with the root; heights are smoothed, or every step would shake the picture.
    const [, , , w, qx, qy, qz] = measured;
    this.yaw = Math.atan2(2 * (w * qz + qx * qy), 1 - 2 * (qy * qy + qz * qz)) || 0;
    if (this.has_root) {
      const step = new THREE.Vector3(x - this.root.x, y - this.root.y, (z - this.root.z) * 0.08);
      for (const moved of [this.root, this.camera.position, this.controls.target]) moved.add(step);
    } else {
      this.has_root = true;
      this.root.set(x, y, z);
      this.resetView();
    }
    for (const low of [this.gate, this.shadow, this.floor]) { low.position.x = this.root.x; low.position.y = this.root.y; }
    this.sun.target.position.set(this.root.x, this.root.y, 0.6);
    this.sun.position.set(this.root.x - 1.6, this.root.y + 1.4, 4.2);
    this.rim.target.position.copy(this.sun.target.position);
    this.rim.position.set(this.root.x + 2.5, this.root.y - 2.2, 1.6);
  }

  resetView() {
    const middle = this.floats === false ? 0.45 : -0.06, yaw = this.yaw + 0.55;
    // In a low panel its words take a sixth of the height from the top.
    const is_low = this.element.clientHeight > 1 && this.element.clientHeight < 340, away_m = is_low ? 3.3 : 2.9;
    this.controls.target.set(this.root.x, this.root.y, this.root.z + middle + (is_low ? 0.08 : 0));
    // From in front, a little to its left and above: face, hands and feet are seen.
    this.camera.position.set(this.root.x + away_m * Math.cos(yaw), this.root.y + away_m * Math.sin(yaw), this.root.z + 0.62);
    this.controls.update();
    this.ask();
  }

  /** @param {any} colours */
  setColours(colours) {
    this.is_dark = colours.is_dark;
    this.ghost ??= ghostMaterial();
    this.ghost.uniforms.colour.value.set(colours.is_dark ? "#f59e42" : "#e07b12");
    this.ghost.uniforms.strength.value = colours.is_dark ? 1 : 1.7;
    this.floor.material.uniforms.line.value.set(colours.line);
    this.floor.material.uniforms.strength.value = colours.is_dark ? 0.55 : 0.75;
    this.trail.mesh.material.uniforms.colour.value.set(colours.trail);
    this.shadow.material.opacity = colours.is_dark ? 0.5 : 0.22;
    this.sky.intensity = colours.is_dark ? 1.5 : 2.1;
    this.sky.groundColor.set(colours.is_dark ? 0x2b3a4a : 0xb9c3cd);
    this.rim.intensity = colours.is_dark ? 1.9 : 0.6;
    this.ask();
  }

  /** @param {number} width @param {number} height @param {number} ratio */
  resize(width, height, ratio) {
    this.ratio = ratio;
    this.renderer.setPixelRatio(this.quality > 1 ? Math.min(ratio, 2) : 1);
    this.renderer.setSize(width, height, false);
    this.element.resize(width, height);
    this.camera.aspect = width / Math.max(1, height);
    // A tall picture sees as much of the robot's width as a wide one of its height.
    this.camera.fov = this.camera.aspect < 0.8 ? 44 : 34;
    this.camera.updateProjectionMatrix();
    this.ask();
  }

  /** @param {any} event */
  input(event) {
    this.element.dispatch(event);
    this.ask();
  }

  /** One frame is drawn for whatever came since the last one. */
  ask() {
    if (this.is_asked) return;
    this.is_asked = true;
    const wait_ms = FRAME_MS[this.quality] - (performance.now() - this.drawn_at) - 8;
    if (wait_ms > 4) setTimeout(() => requestAnimationFrame(() => this.draw()), wait_ms);
    else requestAnimationFrame(() => this.draw());
  }

  draw() {
    this.is_asked = false;
    const began = (this.drawn_at = performance.now());
    if (this.poses) { this.place(); this.poses = null; }
    const moved = this.controls.update();
    this.trail.update();
    this.renderer.render(this.scene, this.camera);
    this.frames += 1;
    this.draw_ms += (performance.now() - began - this.draw_ms) * 0.1;
    if (this.quality > 1 && this.frames > 60 && this.draw_ms > SLOW_MS) {
      this.quality = 1;
      this.renderer.shadowMap.enabled = false;
      this.sun.castShadow = false;
      this.renderer.setPixelRatio(1);
    }
    this.drawn({ frames: this.frames, draw_ms: this.draw_ms });
    if (moved) this.ask();
  }
}
