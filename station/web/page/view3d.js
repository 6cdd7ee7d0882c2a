// The panel of the robot in 3D. It draws nothing itself: a worker does, and this passes it poses, pointers and sizes.
import { byId, brief, el, list, number, show, write } from "./dom.js";
import { OLD_S, age } from "./figures.js";
import { COLOURS } from "./gates.js";

const PASSED = ["button", "buttons", "clientX", "clientY", "pageX", "pageY", "pointerId", "pointerType", "deltaY", "deltaMode", "ctrlKey", "metaKey", "shiftKey", "isPrimary", "key", "code"];
const MOST_JOINTS = 400;

export class View3d extends EventTarget {
  /** @param {import("./link.js").Link} link @param {import("./feeds.js").Feeds} feeds */
  constructor(link, feeds) {
    super();
    this.link = link;
    this.feeds = feeds;
    this.stage = byId("view-stage");
    this.words = byId("view-words");
    this.choice = byId("view-robot");
    this.robot = "";
    /** Names that are offered, one below the other. */
    this.shown = "";
    /** @type {any} */
    this.scene = null;
    this.frames = 0;
    this.draw_ms = NaN;
    this.pose_at = -Infinity;
    this.pose_age_s = NaN;
    /** Chooses a robot of an episode, while one is shown. @type {((name: string) => void) | null} */
    this.choose_recorded = null;
    /** @type {Worker | null} */
    this.worker = null;
    this.start();
    this.choice.addEventListener("change", () => { if (this.choose_recorded) this.choose_recorded(this.choice.value); else void this.choose(this.choice.value); });
    byId("view-reset").addEventListener("click", () => this.worker?.postMessage({ t: "reset" }));
    document.addEventListener("theme", () => this.worker?.postMessage({ t: "colours", colours: colours() }));
    link.addEventListener("state", () => this.robots());
    link.addEventListener("link", () => { if (link.is_up && this.robot && !this.scene && !this.choose_recorded) void this.choose(this.robot); });
    setInterval(() => this.age(), 200);
  }

  start() {
    const canvas = document.createElement("canvas");
    if (!canvas.transferControlToOffscreen || !window.Worker) { this.fail("this browser cannot draw in a worker"); return; }
    canvas.tabIndex = 0;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The robot in 3D. Drag turns, wheel or pinch zooms, right drag moves; plus and minus zoom, arrows turn.");
    this.stage.append(canvas);
    let worker;
    try { worker = new Worker("/page/view3d.worker.js", { type: "module" }); } catch (error) { this.fail(String(error)); return; }
    this.worker = worker;
    worker.onmessage = ({ data }) => {
      if (data.t === "drawn") { this.frames = data.frames; this.draw_ms = data.draw_ms; }
      else if (data.t === "failed") this.fail(data.text);
    };
    worker.onerror = (event) => this.fail(event.message || "its worker did not start");
    const offscreen = canvas.transferControlToOffscreen();
    worker.postMessage({ t: "canvas", canvas: offscreen, colours: colours() }, [offscreen]);
    new ResizeObserver(() => {
      const { clientWidth: width, clientHeight: height } = this.stage;
      if (width && height) worker.postMessage({ t: "size", width, height, ratio: devicePixelRatio });
    }).observe(this.stage);
    this.pass(canvas, worker);
  }

  /** @param {HTMLCanvasElement} canvas @param {Worker} worker */
  pass(canvas, worker) {
    const send = (/** @type {any} */ event, extra = {}) => {
      const box = canvas.getBoundingClientRect();
      /** @type {any} */
      const plain = { type: event.type };
      for (const name of PASSED) if (name in event) plain[name] = event[name];
      if ("clientX" in event) Object.assign(plain, { clientX: event.clientX - box.left, clientY: event.clientY - box.top, pageX: event.clientX - box.left, pageY: event.clientY - box.top });
      worker.postMessage({ t: "input", event: { ...plain, ...extra } });
    };
    for (const type of ["pointerdown", "pointermove", "pointerup", "pointercancel"]) {
      canvas.addEventListener(type, (/** @type {any} */ event) => {
        if (type === "pointerdown") canvas.setPointerCapture(event.pointerId);
        if (type !== "pointermove" || event.buttons) send(event);
      });
    }
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    // The wheel scrolls the page until the picture was touched: a page that catches every wheel cannot be scrolled past.
    canvas.addEventListener("wheel", (event) => {
      if (document.activeElement !== canvas && !event.ctrlKey) return;
      event.preventDefault();
      send(event);
    }, { passive: false });
    canvas.addEventListener("keydown", (event) => {
      const turn = /** @type {Record<string, [number, number]>} */ ({ ArrowLeft: [24, 0], ArrowRight: [-24, 0], ArrowUp: [0, 24], ArrowDown: [0, -24] })[event.key];
      if (turn) {
        event.preventDefault();
        const at = { pointerId: 999, pointerType: "mouse", button: 0, buttons: 1, ctrlKey: false, metaKey: false, shiftKey: false };
        const drag = (/** @type {string} */ type, /** @type {number} */ x, /** @type {number} */ y) => worker.postMessage({ t: "input", event: { ...at, type, clientX: x, clientY: y, pageX: x, pageY: y } });
        drag("pointerdown", 0, 0); drag("pointermove", turn[0], turn[1]); drag("pointerup", turn[0], turn[1]);
      } else if (event.key === "+" || event.key === "-") {
        event.preventDefault();
        worker.postMessage({ t: "input", event: { type: "wheel", deltaY: event.key === "+" ? -90 : 90, deltaMode: 0, ctrlKey: false, clientX: 0, clientY: 0 } });
      }
    });
  }

  /** Without WebGL the rest of the page works on. @param {string} why */
  fail(why) {
    this.worker?.terminate();
    this.worker = null;
    this.stage.replaceChildren();
    byId("view").classList.add("failed");
    this.say(`The robot is not drawn here: ${brief(why, 160)}. Everything else works.`);
  }

  /** @param {string} text */
  say(text) {
    write(this.words, text);
    show(this.words, text !== "");
  }

  robots() {
    if (this.choose_recorded) return;
    const names = list(this.link.state?.robots, 8).map((robot) => brief(robot.name, 120)).filter(Boolean);
    this.offer(names, this.robot);
    if (!names.includes(this.robot) && names.length) void this.choose(names[0]);
    else if (!names.length && !this.robot) this.say("No robot runs.");
  }

  /** @param {string[]} names @param {string} chosen */
  offer(names, chosen) {
    const shown = names.join("\n");
    if (shown !== this.shown) {
      this.shown = shown;
      this.choice.replaceChildren(...names.map((name) => { const option = el("option", "", name); option.value = name; return option; }));
      show(this.choice, names.length > 1);
    }
    if (names.includes(chosen)) this.choice.value = chosen;
  }

  /** An episode is shown in place of a live robot. @param {(name: string) => void} choose one of its robots */
  showRecorded(choose) {
    this.turn = (this.turn ?? 0) + 1;
    if (this.robot) this.feeds.leave(`robot:${this.robot}`);
    this.choose_recorded = choose;
    this.clear("Reading the episode…");
  }

  showLive() {
    this.choose_recorded = null;
    this.clear("");
    const before = this.robot;
    this.robot = "";
    if (list(this.link.state?.robots, 8).some((robot) => robot.name === before)) void this.choose(before);
    this.robots();
  }

  /** Nothing of what was shown stays. @param {string} words */
  clear(words) {
    this.shown = "";
    this.pose_at = -Infinity;
    this.pose_age_s = NaN;
    this.stage.classList.remove("old");
    this.setScene({ bodies: [], joints: [], shapes: [] });
    this.scene = null;
    this.say(words);
  }

  /** @param {string} name */
  async choose(name) {
    const turn = (this.turn = (this.turn ?? 0) + 1);  // of two that ask at once, the later one counts
    if (this.robot) this.feeds.leave(`robot:${this.robot}`);
    this.robot = name;
    this.scene = null;
    this.choice.value = name;
    let scene;
    try {
      const answer = await fetch(`/api/scene?robot=${encodeURIComponent(name)}`, { signal: AbortSignal.timeout?.(20000) });
      scene = await answer.json();
      if (!answer.ok) throw new Error(scene?.error ?? `the station answered ${answer.status}`);
    } catch (error) {
      if (this.turn !== turn) return;
      if (this.worker) this.say(`No picture of ${brief(name, 60)}: ${brief(error instanceof Error ? error.message : error, 160)}`);
      setTimeout(() => { if (this.turn === turn) void this.choose(name); }, 3000);
      return;
    }
    if (this.turn !== turn) return;
    this.setScene(scene);
    this.feeds.want(`robot:${name}`, (header, data, offset) => {
      if (this.scene !== scene) return;
      this.pose_at = performance.now();
      this.pose_age_s = number(header.age_ms, 0) / 1000;
      this.link.measured_at_s.set(name, this.pose_at / 1000 - this.pose_age_s);
      const { q, command, gate } = this.setPoses(header, data, offset);
      this.dispatchEvent(new CustomEvent("joints", { detail: { at_s: this.pose_at / 1000 - this.pose_age_s, q, command, gate } }));
    });
  }

  /** @param {any} scene as `GET /api/scene` gives it */
  setScene(scene) {
    scene.joints = (Array.isArray(scene.joints) ? scene.joints : []).slice(0, MOST_JOINTS).map(String);
    this.scene = scene;
    const is_drawn = Array.isArray(scene.shapes) && scene.shapes.length > 0;
    if (this.worker) {
      this.worker.postMessage({ t: "robot", robot: scene });
      this.say(is_drawn ? "" : brief(scene.note, 200) || "There is no model of this robot.");
    }
    this.dispatchEvent(new CustomEvent("robot", { detail: scene }));
  }

  /**
   * Shows a frame of the scene's robot.
   * @param {any} header @param {ArrayBuffer} data @param {number} offset of its numbers
   * @returns {{q: Float32Array | null, command: Float32Array | null, gate: string, end: number}} its joints, and where its numbers end
   */
  setPoses(header, data, offset) {
    const { scene } = this, bodies = Array.isArray(scene.bodies) ? scene.bodies.length : 0, joints = scene.joints.length;
    const floats = new Float32Array(data, offset, Math.floor((data.byteLength - offset) / 4));
    let at = 0;
    const take = (/** @type {number} */ count) => { const part = floats.slice(at, at + count); at += count; return part.length === count ? part : null; };
    const measured = header.has_pose ? take(7 * bodies) : null, reference = header.has_ghost ? take(7 * bodies) : null;
    const q = take(joints), command = take(joints);
    const gate = String(header.gate ?? "");
    const buffers = [measured, reference].filter((part) => part !== null).map((part) => part.buffer);
    this.worker?.postMessage({ t: "poses", measured, reference, gate: Object.hasOwn(COLOURS, gate) ? COLOURS[gate] : "" }, buffers);
    return { q, command, gate, end: offset + 4 * at };
  }

  /** The way that the root came, after time jumped. @param {[number, number][]} points [m] */
  setTrail(points) { this.worker?.postMessage({ t: "trail", points }); }

  age() {
    if (this.choose_recorded) return;
    const old_s = this.pose_age_s + (performance.now() - this.pose_at) / 1000;
    const node = byId("view-age"), is_old = !(old_s <= OLD_S);
    write(node, Number.isNaN(old_s) || !Number.isFinite(old_s) ? "" : is_old ? `${age(old_s)} old` : age(old_s));
    node.classList.toggle("old", is_old);
    this.stage.classList.toggle("old", is_old && Number.isFinite(old_s));
  }
}

/** What the worker must know of the theme. */
function colours() {
  const style = getComputedStyle(document.documentElement);
  return {
    line: style.getPropertyValue("--grid").trim(),
    trail: style.getPropertyValue("--state").trim(),
    is_dark: document.documentElement.dataset.theme === "dark",
  };
}
