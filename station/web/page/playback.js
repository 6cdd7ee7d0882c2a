// An episode in place of the live station: the same robot, cameras and curves, and a bar that says so and moves in time.
// Header, stop, alarms and the desk stay live. A process of its own plays to this page alone; what it sends is numbered,
// so that nothing of an earlier one is shown.
import { brief, byId, el, list, number, show, write } from "./dom.js";
import { moment } from "./figures.js";

const FEEDS = ["play", "play:episode", "play:scene", "play:robot"], MOST_EVENTS = 600, MOST_ROWS = 2000;
const AGAIN_MS = 400, STEP_S = 0.1, LONG_STEP_S = 1, PAGE_STEP_S = 10;

export class Playback {
  /**
   * @param {import("./feeds.js").Feeds} feeds @param {import("./view3d.js").View3d} view
   * @param {import("./cameras.js").Cameras} cameras @param {import("./curves.js").Curves} curves
   */
  constructor(feeds, view, cameras, curves) {
    this.feeds = feeds;
    this.view = view;
    this.camera_panel = cameras;
    this.curves = curves;
    this.opened = 0;
    this.order = 0;
    this.live_clock = curves.clock;
    this.episode = "";
    this.time_s = this.start_s = 0;
    this.length_s = NaN;
    this.is_playing = this.is_held = false;
    this.error = this.robot = "";
    /** @type {string[]} */
    this.cameras = [];
    /** When the newest picture of each camera came, where time is. @type {Record<string, unknown>} */
    this.pictures = {};
    /** Where this page wants to be, until it is there [s]. @type {number | null} */
    this.wanted_s = null;
    /** The order of it that was sent last. @type {{time_s: number, at: number, order: number} | null} */
    this.sent = null;
    this.answered = 0;
    this.jumps = -1;
    /** The newest of the robot, for tests. @type {{robot: string, time_s: number, q: number[]} | null} */
    this.pose = null;
    /** @type {any} */
    this.opener = null;
    this.slider = byId("playback-slider");
    this.speed = byId("playback-speed");
    this.jump = byId("playback-jump");
    byId("playback-live").addEventListener("click", () => this.close());
    byId("playback-play").addEventListener("click", () => this.ask({ is_playing: !this.is_playing }));
    this.speed.addEventListener("change", () => this.ask({ speed: Number(this.speed.value) }));
    this.jump.addEventListener("change", () => { if (this.jump.value) this.goTo(Number(this.jump.value)); this.jump.selectedIndex = 0; });
    this.slider.addEventListener("input", () => this.goTo(Number(this.slider.value)));
    this.slider.addEventListener("pointerdown", () => { this.is_held = true; });
    for (const end of ["pointerup", "pointercancel", "blur"]) this.slider.addEventListener(end, () => { this.is_held = false; });
    this.slider.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => this.key(event));
    feeds.addEventListener("open", () => { if (this.episode) this.begin(); });
    setInterval(() => this.goOn(), AGAIN_MS);
  }

  /** @param {string} episode */
  forget(episode) {
    Object.assign(this, {
      episode, time_s: 0, start_s: 0, length_s: NaN, is_playing: false, is_held: false, error: "", robot: "", cameras: [], pictures: {},
      wanted_s: null, sent: null, answered: 0, jumps: -1, pose: null,
    });
  }

  /** What is shown, for tests in a browser. */
  get summary() {
    if (!this.episode) return null;
    const { episode, time_s, start_s, length_s, is_playing, error, robot, cameras, pictures, pose } = this;
    return structuredClone({ episode, time_s, start_s, length_s, is_playing, error, robot, cameras, pictures: { ...pictures }, pose, speed: Number(this.speed.value), note: byId("playback-note").textContent, is_settled: this.wanted_s === null && pose?.time_s === time_s, joints: this.view.scene?.joints ?? [], past: this.curves.frames.map((frame) => frame.at_s) });
  }

  /** @param {string} episode @param {any} [opener] gets the focus back */
  open(episode, opener = null) {
    this.forget(episode);
    this.opener = opener;
    this.view.showRecorded((robot) => this.ask({ robot }));
    this.curves.clock = () => this.time_s;
    this.curves.zero = "0 s";
    this.speed.value = "1";
    write(byId("playback-episode"), `Episode ${brief(episode, 120)}`);
    document.documentElement.classList.add("shows-episode");
    show(byId("playback"), true);
    this.camera_panel.setRecorded(this);
    this.is_playing = true;
    this.begin();
    this.show();
    byId("playback-live").focus();
    byId("view").scrollIntoView({ block: "nearest" });
  }

  /** Has a player begin, also in place of one that went with its socket. */
  begin() {
    this.opened += 1;
    this.jumps = -1;
    this.wanted_s = this.sent = null;
    const uses = [this.setState, this.setEpisode, this.setScene, this.setRobot];
    FEEDS.forEach((feed, place) => this.feeds.want(feed, (header, data, offset) => {
      if (this.isOurs(header)) uses[place].call(this, header, data, offset);
    }));
    const robot = this.robot ? { robot: this.robot } : {};
    this.ask({ is_playing: this.is_playing, speed: Number(this.speed.value), ...(Number.isNaN(this.length_s) ? {} : { time_s: this.time_s }), ...robot });
  }

  close() {
    if (!this.episode) return;
    this.feeds.say({ play: null });
    for (const feed of FEEDS) this.feeds.leave(feed);
    this.opened += 1;
    this.forget("");
    document.documentElement.classList.remove("shows-episode");
    this.curves.clock = this.live_clock;
    this.curves.zero = "now";
    this.camera_panel.setRecorded(null);
    this.view.showLive();
    show(byId("playback"), false);
    (this.opener?.isConnected ? this.opener : byId("station")).focus();
    this.opener = null;
  }

  /** Whether a frame is of the player that plays now. @param {any} header */
  isOurs(header) { return this.episode !== "" && header.opened === this.opened; }

  /** @param {object} order */
  ask(order) {
    this.order += 1;
    this.feeds.say({ play: { episode: this.episode, opened: this.opened, order: { number: this.order, ...order } } });
    return this.order;
  }

  /** Goes to an instant. @param {number} time_s */
  goTo(time_s) {
    const to_s = Math.min(this.length_s, Math.max(this.start_s, time_s));
    if (Number.isNaN(to_s)) return;
    this.wanted_s = to_s;
    this.goOn();
    this.showTime();
  }

  /** While one order to go somewhere is open, only the newest waits, and is sent once that one was obeyed. */
  goOn() {
    const { wanted_s, sent } = this, now = performance.now();
    if (wanted_s === null || (sent && sent.order > this.answered && now - sent.at < AGAIN_MS)) return;
    if (sent && sent.time_s === wanted_s && sent.order <= this.answered) { this.wanted_s = this.sent = null; return; }
    this.sent = { time_s: wanted_s, at: now, order: this.ask({ time_s: wanted_s }) };
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    const step_s = event.shiftKey ? LONG_STEP_S : STEP_S;
    const by_s = /** @type {Record<string, number>} */ ({ ArrowLeft: -step_s, ArrowDown: -step_s, ArrowRight: step_s, ArrowUp: step_s, PageUp: PAGE_STEP_S, PageDown: -PAGE_STEP_S })[event.key];
    if (by_s === undefined || event.ctrlKey || event.metaKey || event.altKey) return;
    event.preventDefault();
    this.goTo((this.wanted_s ?? this.time_s) + by_s);
  }

  /** @param {any} header */
  setState(header) {
    if (header.is_waiting) { write(byId("playback-note"), Number.isNaN(this.length_s) ? "It is being read…" : "The disk is slow…"); return; }
    if (header.error) {
      this.error = brief(header.error, 300) || "it cannot be played";
      this.is_playing = false;
      this.view.say("");
    } else {
      this.answered = number(header.number, 0);
      this.time_s = number(header.time_s, 0);
      this.is_playing = header.is_playing === true;
      this.robot = brief(header.robot, 120);
      this.pictures = header.pictures ?? {};
      this.view.choice.value = this.robot;
    }
    write(byId("playback-note"), this.error ? `It cannot be played: ${this.error}` : brief(header.note, 300));
    this.goOn();
    this.show();
  }

  /** @param {any} _ @param {ArrayBuffer} data @param {number} offset */
  setEpisode(_, data, offset) {
    const told = JSON.parse(new TextDecoder().decode(new Uint8Array(data, offset)));
    this.start_s = number(told.start_s, 0);
    this.length_s = number(told.length_s, 0);
    const texts = (/** @type {unknown} */ names) => (Array.isArray(names) ? names.slice(0, 8).map(String) : []);
    this.cameras = texts(told.cameras);
    this.view.offer(texts(told.robots), this.robot);
    this.slider.min = String(this.start_s);
    this.slider.max = String(this.length_s);
    this.setEvents(list(told.events, MOST_EVENTS));
    this.camera_panel.show();
    this.show();
  }

  /** @param {any[]} events */
  setEvents(events) {
    const span_s = this.length_s - this.start_s;
    byId("playback-marks").replaceChildren(...events.map((event) => {
      const mark = el("i", ["mark", "warning", "error"].includes(event.kind) ? event.kind : "");
      mark.style.left = `${span_s > 0 ? ((100 * (number(event.at_s, 0) - this.start_s)) / span_s).toFixed(3) : 0}%`;
      return mark;
    }));
    const first = el("option", "", events.length ? "Marks and events" : "No marks or events");
    first.value = "";
    this.jump.replaceChildren(first, ...events.map((event) => {
      const option = el("option", "", `${moment(event.at_s)} ${brief(event.text, 60)}`);
      option.value = String(number(event.at_s, 0));
      return option;
    }));
    this.jump.disabled = events.length === 0;
  }

  /** @param {any} _ @param {ArrayBuffer} data @param {number} offset */
  setScene(_, data, offset) {
    this.jumps = -1;
    this.view.setScene(JSON.parse(new TextDecoder().decode(new Uint8Array(data, offset))));
  }

  /** @param {any} header @param {ArrayBuffer} data @param {number} offset */
  setRobot(header, data, offset) {
    const { view } = this;
    if (!view.scene || header.robot !== view.scene.robot) return;
    const joints = view.scene.joints.length, at_s = number(header.time_s, 0), is_new = header.jump !== this.jumps;
    this.jumps = header.jump;
    const numbers = view.setPoses(header, data, offset).end;
    const width = 4 + 2 * joints, count = Math.min(number(header.rows, 0), MOST_ROWS);
    const rows = new Float32Array(data, numbers, Math.min(count * width, Math.floor((data.byteLength - numbers) / 4)));
    const past = [], way = /** @type {[number, number][]} */ ([]);
    for (let row = 0; (row + 1) * width <= rows.length; row += 1) {
      const part = rows.subarray(row * width, (row + 1) * width);
      past.push({ at_s: at_s + part[0], gate: String(header.gates?.[part[1]] ?? ""), q: part.slice(4, 4 + joints), command: part.slice(4 + joints) });
      way.push([part[2], part[3]]);
    }
    const last = past.at(-1);
    this.pose = { robot: header.robot, time_s: at_s, q: last ? [...last.q] : [] };
    if (is_new) { this.curves.setPast(past); view.setTrail(way); } else for (const frame of past) this.curves.add(frame);
  }

  show() {
    const is_there = !this.error && !Number.isNaN(this.length_s), play = byId("playback-play");
    show(byId("playback-controls"), !this.error);
    for (const control of [play, this.slider, this.speed]) control.disabled = !is_there;
    write(play, this.is_playing ? "Pause" : "Play");
    write(byId("playback-length"), is_there ? moment(this.length_s) : "…");
    write(byId("view-age"), is_there ? `at ${moment(this.time_s)}` : "");
    this.showTime();
  }

  showTime() {
    const at_s = this.wanted_s ?? this.time_s;
    write(byId("playback-time"), Number.isNaN(this.length_s) ? "…" : moment(at_s));
    if (!this.is_held) this.slider.value = String(at_s);
    this.slider.setAttribute("aria-valuetext", `${moment(at_s)} of ${moment(this.length_s)}`);
  }
}
