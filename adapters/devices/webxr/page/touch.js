// Two pads under two thumbs: sticks, or where the phone is itself a hand, buttons. The left one is the dead-man as well: without
// a finger on it nothing is asked for.
import { Frame, PARTS } from "./frame.js";

const REACH = 0.33;  // of a pad's width, from its middle to full deflection
const AT_REST = 3;  // frames: what the station has not seen released drives nothing

class Pad {
  /** @param {HTMLElement} node @param {() => void} let_go @param {() => void} grabbed */
  constructor(node, let_go, grabbed) {
    this.node = node;
    /** @type {number | null} */
    this.pointer = null;
    this.x = this.y = 0;
    node.addEventListener("pointerdown", (event) => {
      if (this.pointer !== null || event.button !== 0) return;
      event.preventDefault();
      this.pointer = event.pointerId;
      try { node.setPointerCapture(event.pointerId); } catch { /* it is gone already */ }
      this.move(event);
      grabbed();
    });
    node.addEventListener("pointermove", (event) => { if (event.pointerId === this.pointer) this.move(event); });
    for (const end of ["pointerup", "pointercancel", "lostpointercapture"]) {
      node.addEventListener(end, (event) => { if (/** @type {PointerEvent} */ (event).pointerId === this.pointer) { this.release(); let_go(); } });
    }
    node.addEventListener("contextmenu", (event) => event.preventDefault());
  }

  /** @param {PointerEvent} event */
  move(event) {
    const box = this.node.getBoundingClientRect(), reach = box.width * REACH;
    let x = (event.clientX - box.left - box.width / 2) / reach, y = (event.clientY - box.top - box.height / 2) / reach;
    const length = Math.hypot(x, y);
    if (length > 1) { x /= length; y /= length; }
    this.set(x, y);
  }

  get is_held() { return this.pointer !== null; }

  release() {
    this.pointer = null;
    this.set(0, 0);
  }

  /** @param {number} x to the right @param {number} y down, -1 to 1 */
  set(x, y) {
    this.x = x;
    this.y = y;
    this.node.style.setProperty("--x", String(x * 0.95));
    this.node.style.setProperty("--y", String(y * 0.95));
    this.node.classList.toggle("held", this.is_held);
  }
}

export class Touch extends EventTarget {
  /** @param {import("./line.js").Line} line @param {HTMLElement} left @param {HTMLElement} right @param {() => boolean} is_free */
  constructor(line, left, right, is_free) {
    super();
    this.line = line;
    this.is_free = is_free;
    this.frame = new Frame();
    /** Whether frames are sent, and how many were. */
    this.is_on = false;
    this.frames = 0;
    const changed = () => this.dispatchEvent(new Event("change"));
    this.left = new Pad(left, changed, () => { this.begin(); changed(); });
    this.right = new Pad(right, changed, changed);
    for (const [target, name, why] of /** @type {[EventTarget, string, string][]} */ ([
      [window, "blur", "another window was opened"], [window, "pagehide", "the page was left"], [document, "visibilitychange", "the page is hidden"],
    ])) target.addEventListener(name, () => this.end(why));
  }

  get is_held() { return this.left.is_held; }

  /** Sends frames from now on: at once where there is no headset, else from the first touch. */
  begin() {
    if (this.is_on) return;
    this.is_on = true;
    requestAnimationFrame((now) => this.step(now));
  }

  /** @param {string} why */
  end(why) {
    const was_held = this.is_held;
    this.release();
    if (was_held) this.line.letGo(why);
  }

  release() {
    this.left.release();
    this.right.release();
    this.dispatchEvent(new Event("change"));
  }

  /** @param {number} now */
  step(now) {
    if (!this.is_on) return;
    requestAnimationFrame((next) => this.step(next));
    if (!this.is_free()) return;
    const { frame, left, right, is_held } = this, controls = frame.controls;
    frame.clear();
    this.frames += 1;
    if (is_held && this.frames > AT_REST) { controls[2] = left.x; controls[3] = left.y; controls[9] = right.x; controls[10] = right.y; controls[14] = 1; }
    frame.parts = PARTS.controls_left | PARTS.controls_right | PARTS.touch;
    this.line.send(frame, now);
  }
}
