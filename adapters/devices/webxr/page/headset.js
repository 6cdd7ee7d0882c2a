// A WebXR session: what the browser tells of head, controllers and hands goes out with every animation frame. A phone that
// shows the room has none of them: it is itself the right hand, and thumbs on its screen are the buttons.
import { BODY, Frame, JOINTS, PARTS } from "./frame.js";
import { Scene } from "./scene.js";

const BUTTONS = [0, 1, 3, 4, 5], AT = [0, 1, 4, 5, 6];  // trigger, squeeze, stick, A or X, B or Y; where a frame has them
const PULSES = { up: [0.4, 60], down: [0.3, 60], note: [0.2, 40], no: [0.6, 180], lost: [0.9, 300], begin: [0.4, 120], end: [0.4, 120], alarm: [1, 600] };

/** The way in that this browser has, the room in view before a dark one; "" for none. @returns {Promise<string>} */
export async function modeOf() {
  for (const mode of ["immersive-ar", "immersive-vr"]) {
    try { if (await /** @type {any} */ (navigator).xr?.isSessionSupported(mode)) return mode; } catch { /* not allowed here */ }
  }
  return "";
}

/** Whether an input stays: a controller, or a hand. A touch of a screen, or a pinch where somebody looks, comes and goes. @param {any} source */
const stays = (source) => source.targetRayMode === "tracked-pointer";

export class Headset extends EventTarget {
  /**
   * @param {import("./line.js").Line} line @param {import("./pictures.js").Pictures} pictures
   * @param {HTMLCanvasElement} canvas @param {import("./touch.js").Touch} touch the thumbs on a phone's screen
   */
  constructor(line, pictures, canvas, touch) {
    super();
    this.line = line;
    this.pictures = pictures;
    this.canvas = canvas;
    this.touch = touch;
    /** Whether the session's screen is in a hand, and not before the eyes. */
    this.is_phone = false;
    this.frame = new Frame();
    this.poses = new Float32Array(JOINTS * 16);
    /** @type {any} */
    this.session = null;
    this.frames = 0;
    this.pulses = 0;
    line.addEventListener("cue", (/** @type {any} */ event) => this.pulse(event.detail.tune));
    line.addEventListener("change", () => { if (this.session && line.is_up) this.tellAbout(); });
    addEventListener("pagehide", () => this.letGo("the page was left"));
    document.addEventListener("visibilitychange", () => { if (document.hidden && !this.session) this.letGo("the page is hidden"); });
  }

  /** Begins a session; to be called by a touch or a click. @param {string} mode */
  async enter(mode) {
    const xr = /** @type {any} */ (navigator).xr;
    const session = await xr.requestSession(mode, {
      requiredFeatures: ["local-floor"], optionalFeatures: ["hand-tracking", "body-tracking", "dom-overlay"], domOverlay: { root: document.body },
    });
    this.is_phone = session.interactionMode === "screen-space" || session.domOverlayState?.type === "screen";  // older ones have but one
    if (this.is_phone && !session.domOverlayState) {
      await session.end();
      throw new Error("this browser shows no page over the room, so a phone would have no stop in view");
    }
    this.session = session;
    const gl = /** @type {WebGL2RenderingContext | null} */ (this.canvas.getContext("webgl2", { xrCompatible: true }));
    if (!gl) { await session.end(); throw new Error("this browser draws no WebGL, which WebXR needs"); }
    await gl.makeXRCompatible?.();
    if (!this.is_phone) this.scene ??= new Scene(gl, mode === "immersive-ar");
    session.updateRenderState({ baseLayer: new (/** @type {any} */ (window).XRWebGLLayer)(session, gl) });
    this.space = await session.requestReferenceSpace("local-floor");
    this.space.addEventListener("reset", () => this.letGo("the headset's world was placed anew"));
    session.addEventListener("end", () => { this.session = null; this.touch.release(); this.letGo("the session ended"); this.dispatchEvent(new Event("change")); });
    session.addEventListener("visibilitychange", () => { if (session.visibilityState !== "visible") this.letGo("the headset's menu is open, or it was taken off"); });
    session.addEventListener("inputsourceschange", (/** @type {any} */ event) => {
      if ([...event.added, ...event.removed].some(stays)) { this.letGo("a controller or a hand came or went"); this.tellAbout(); }
    });
    this.tellAbout();
    this.dispatchEvent(new Event("change"));
    session.requestAnimationFrame((/** @type {number} */ now, /** @type {any} */ frame) => this.step(now, frame));
  }

  /** @param {string} why */
  letGo(why) {
    if (!this.frames) return;  // nothing was driven yet
    this.line.letGo(why);
    this.scene?.say(why, false);
  }

  tellAbout() {
    const about = { browser: navigator.userAgent.slice(0, 200) };
    if (this.session && this.is_phone) about.right_input = "phone";
    for (const source of this.session?.inputSources ?? []) {
      if (source.handedness !== "none" && stays(source)) about[`${source.handedness}_input`] = source.hand ? "hand" : String(source.profiles?.[0] ?? "");
    }
    this.line.say({ t: "about", about });
  }

  /** @param {number} now @param {any} xr an XRFrame */
  step(now, xr) {
    const session = xr.session;
    session.requestAnimationFrame((/** @type {number} */ next, /** @type {any} */ frame) => this.step(next, frame));
    const viewer = xr.getViewerPose(this.space);
    this.scene?.draw(session.renderState.baseLayer, viewer, this.pictures);
    // While its menu is open a headset may go on giving poses that nobody means.
    if (session.visibilityState !== "visible" || !viewer) return;
    this.frames += 1;
    this.frame.clear();
    if (this.is_phone) this.phone(viewer);
    else {
      this.frame.pose("head", viewer.transform);
      for (const source of session.inputSources) {
        const side = source.handedness;
        if ((side === "left" || side === "right") && stays(source)) this.input(xr, source, side);
      }
      if (xr.body) this.body(xr);
    }
    this.line.send(this.frame, now);
  }

  /** @param {any} viewer where the phone is */
  phone(viewer) {
    if (!viewer.emulatedPosition) this.frame.pose("right", viewer.transform);
    this.frame.controls[7] = this.touch.right.is_held ? 1 : 0;
    this.frame.controls[14] = this.touch.is_held ? 1 : 0;
    this.frame.parts |= PARTS.controls_right | PARTS.touch;
  }

  /** @param {any} xr @param {any} source @param {"left" | "right"} side */
  input(xr, source, side) {
    if (source.hand) { this.hand(xr, source.hand, side); return; }
    const grip = source.gripSpace ? xr.getPose(source.gripSpace, this.space) : null;
    if (grip && !grip.emulatedPosition) this.frame.pose(side, grip.transform);  // what a headset only guesses leads no hand
    const pad = source.gamepad;
    if (!pad || pad.mapping !== "xr-standard") return;
    const controls = this.frame.controls, first = side === "left" ? 0 : 7;
    BUTTONS.forEach((button, index) => { controls[first + AT[index]] = pad.buttons[button]?.value ?? 0; });
    controls[first + 2] = pad.axes[2] ?? 0;
    controls[first + 3] = pad.axes[3] ?? 0;
    this.frame.parts |= PARTS[`controls_${side}`];
  }

  /** @param {any} xr @param {any} hand @param {"left" | "right"} side */
  hand(xr, hand, side) {
    const rows = this.frame[`hand_${side}`];
    let index = 0;
    for (const joint of hand.values()) {
      const pose = xr.getJointPose(joint, this.space);
      if (!pose || index >= JOINTS) return;
      const { position, orientation } = pose.transform, at = index * 7;
      rows[at] = position.x; rows[at + 1] = position.y; rows[at + 2] = position.z;
      rows[at + 3] = orientation.x; rows[at + 4] = orientation.y; rows[at + 5] = orientation.z; rows[at + 6] = orientation.w;
      index += 1;
    }
    if (index === JOINTS) this.frame.parts |= PARTS[`hand_${side}`];
  }

  /** Where the browser tracks the whole body. @param {any} xr */
  body(xr) {
    for (let index = 0; index < BODY.length; index += 1) {
      const space = xr.body.get(BODY[index]), pose = space ? xr.getPose(space, this.space) : null;
      if (!pose) return;
      const { x, y, z } = pose.transform.position;
      this.frame.body.set([x, y, z], index * 3);
    }
    this.frame.parts |= PARTS.body;
  }

  /** What happens is felt in both hands. @param {string} tune */
  pulse(tune) {
    const [strength, ms] = PULSES[tune] ?? PULSES.note;
    for (const source of this.session?.inputSources ?? []) {
      const actuator = source.gamepad?.hapticActuators?.[0];
      if (actuator?.pulse) { this.pulses += 1; void actuator.pulse(strength, ms); }
    }
  }
}
