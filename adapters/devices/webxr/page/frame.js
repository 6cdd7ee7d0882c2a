// A frame as the station takes it: little-endian, in WebXR's own axes. Its layout is that of adapters/devices/webxr/frame.py.
export const JOINTS = 25, CONTROLS = 15;
const MAGIC = 0x31525853, BYTES = 1820;
export const PARTS = { head: 1, left: 2, right: 4, controls_left: 8, controls_right: 16, hand_left: 32, hand_right: 64, touch: 128, body: 256 };
const SIDES = ["left", "right"];
/** Joints of a body whose places are sent, by the names of WebXR; the order is that of adapters/devices/webxr/body.py. */
export const BODY = ["head", "neck", "spine-middle",
  ...["upper-leg", "lower-leg", "foot-ankle", "foot-ball", "arm-upper", "arm-lower", "hand-wrist", "hand-index-metacarpal", "hand-little-metacarpal"]
    .flatMap((name) => SIDES.map((side) => `${side}-${name}`))];

export class Frame {
  constructor() {
    this.buffer = new ArrayBuffer(BYTES);
    this.view = new DataView(this.buffer);
    this.view.setUint32(0, MAGIC, true);
    const floats = (/** @type {number} */ at, /** @type {number} */ count) => new Float32Array(this.buffer, at, count);
    /** Poses: x y z [m] qx qy qz qw. */
    this.head = floats(24, 7);
    this.left = floats(52, 7);
    this.right = floats(80, 7);
    /** Of each side: trigger, grip, stick x and y, stick click, primary, secondary; then whether a touch pad is held. */
    this.controls = floats(108, CONTROLS);
    this.hand_left = floats(168, JOINTS * 7);
    this.hand_right = floats(868, JOINTS * 7);
    this.body = floats(1568, BODY.length * 3);
    this.parts = 0;
  }

  clear() {
    this.parts = 0;
    this.controls.fill(0);
  }

  /** @param {"head" | "left" | "right"} part @param {any} transform an XRRigidTransform */
  pose(part, transform) {
    const { position, orientation } = transform, row = this[part];
    row[0] = position.x; row[1] = position.y; row[2] = position.z;
    row[3] = orientation.x; row[4] = orientation.y; row[5] = orientation.z; row[6] = orientation.w;
    this.parts |= PARTS[part];
  }

  /** @param {number} taken_ms of the animation frame @returns {ArrayBuffer} stamped with now */
  sealed(taken_ms) {
    this.view.setUint32(4, this.parts, true);
    this.view.setFloat64(8, taken_ms, true);
    this.view.setFloat64(16, performance.now(), true);
    return this.buffer;
  }
}
