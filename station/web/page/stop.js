// The stop. A press leaves the page two ways at once, on the socket and as a POST, with one id, and again every 100 ms
// until one of them said that the bus has it, for as long as the page lives. What the page then says of it comes from the
// robots' gates: `taken` is not `stopped`.
import { byId, brief, dress, list, number, show, write } from "./dom.js";
import { age } from "./figures.js";
import { LATCHED } from "./gates.js";
import { holdButton } from "./hold.js";
import { uuid } from "./link.js";

const AGAIN_MS = 100, NOT_TAKEN_MS = 350, NO_GATE_MS = 1500, FRESH_S = 0.9, NEWS_S = 0.8, MOST_POSTS = 3, POST_MS = 1000, RELEASE_S = 2;

/** Sends presses until they are taken. */
export class Sender extends EventTarget {
  /** @param {import("./link.js").Link} link */
  constructor(link) {
    super();
    this.link = link;
    /** @type {{key: string}} */
    this.me = { key: "" };
    /** @type {null | {id: string, at: number, taken_at: number, text: string, past_bus: boolean}} */
    this.press = null;
    this.posts = 0;
    this.tries = 0;
    link.addEventListener("got-stop", (/** @type {any} */ event) => this.answered(event.detail));
    setInterval(() => this.again(), AGAIN_MS);
  }

  start() {
    const now = performance.now();
    if (!this.press || this.press.taken_at) this.press = { id: uuid(), at: now, taken_at: 0, text: "", past_bus: false };
    this.again();
    this.dispatchEvent(new Event("change"));
  }

  again() {
    const press = this.press;
    if (!press || press.taken_at) return;
    this.tries += 1;
    // Both ways, each guarded: a socket that throws must not keep the POST from leaving.
    try { this.link.send({ t: "stop", id: press.id, key: this.me.key, reason: "console" }); } catch { /* the POST goes */ }
    if (this.posts < MOST_POSTS) void this.post(press);
  }

  /** @param {{id: string}} press */
  async post(press) {
    this.posts += 1;
    try {
      const answer = await fetch("/stop", {
        method: "POST", keepalive: true, cache: "no-store", signal: AbortSignal.timeout?.(POST_MS),
        headers: { "Content-Type": "application/json", "X-Station": "1", "X-Station-Stop": this.me.key },
        body: JSON.stringify({ id: press.id, reason: "console" }),
      });
      if (answer.ok || answer.status === 503) this.answered(await answer.json());
      else if (answer.status === 403 || answer.status === 401) this.answered({ id: press.id, said: "not-taken", text: "the station does not know this page's key: open its link again" });
    } catch { /* no server: the next try is 100 ms away */ }
    finally { this.posts -= 1; }
  }

  /** @param {any} answer */
  answered(answer) {
    const press = this.press;
    if (!press || answer?.id !== press.id || press.taken_at) return;
    if (answer.said === "taken") press.taken_at = performance.now();
    press.past_bus = answer.said === "past-bus";
    press.text = brief(answer.text, 160);
    this.dispatchEvent(new Event("change"));
  }
}

/**
 * What the stop says: its kind (a class), its word, and more.
 * @param {null | {at: number, taken_at: number, text: string, past_bus: boolean}} press @param {any} state newest whole one
 * @param {number} silence_s since it came @param {boolean} is_up @param {number} now [ms]
 */
export function stopWord(press, state, silence_s, is_up, now) {
  const robots = list(state?.robots, 20);
  const name = (/** @type {any} */ robot) => brief(robot.server || robot.name, 40);
  const silent = (/** @type {any} */ robot) => (Number.isNaN(number(robot.age_s)) ? "silent" : `silent for ${age(robot.age_s + silence_s)}`);
  const fresh = robots.filter((robot) => robot.age_s + silence_s < FRESH_S);
  const stopped = fresh.filter((robot) => LATCHED.has(robot.gate));
  const others = robots.filter((robot) => !stopped.includes(robot));
  const names = (/** @type {any[]} */ some) => some.map(name).join(", ");
  const asked = Boolean(state?.stop) && silence_s < FRESH_S;
  if (press && !press.taken_at) {
    if (now - press.at < NOT_TAKEN_MS) return { kind: "stopping", word: "stopping…", more: "" };
    if (press.past_bus) return { kind: "not-taken", word: "told past the bus: see that every robot is damped", more: press.text };
    const why = press.text || (is_up ? "no answer yet" : "no link to the station");
    return { kind: "not-taken", word: "NOT TAKEN: use the robot’s own button", more: `${why}; trying again until it is taken` };
  }
  // A robot whose newest word is `stopped` did stop, though its server has ended since: a runbook ends with a stop.
  const ended = others.filter((robot) => LATCHED.has(robot.gate));
  if (ended.length && ended.length === others.length && is_up) {
    return { kind: "stopped", word: `STOPPED: ${names(robots)}`, more: `since then ${ended.map((robot) => `${name(robot)} is ${silent(robot)}`).join(", ")}` };
  }
  if (robots.length && !others.length && stopped.length) {
    const reason = brief(state.stop?.reason ?? stopped[0].reason, 80);
    return { kind: "stopped", word: `STOPPED: ${names(stopped)}`, more: reason };
  }
  if (press?.taken_at || asked) {
    if (!robots.length) return { kind: "taken", word: "taken", more: is_up ? "no robot runs here" : "no link: no robot can say that it stopped" };
    if (!stopped.length && !is_up) return { kind: "not-taken", word: "taken, then the link was lost: use the robot’s own button", more: "" };
    const waited = press?.taken_at ? now - press.taken_at : Infinity;
    const late = waited > NO_GATE_MS && (waited < Infinity || (state.stop?.since_s ?? 0) * 1000 > NO_GATE_MS);
    const rest = others.map((robot) => `${name(robot)} ${robot.age_s + silence_s < FRESH_S ? brief(robot.gate, 20) || "says nothing" : silent(robot)}`).join(", ");
    if (late) return { kind: "not-taken", word: `${stopped.length ? `${names(stopped)} stopped; ` : "taken, but "}${names(others)} did not say so: use its own button`, more: rest };
    return { kind: "taken", word: "taken", more: rest };
  }
  if (!is_up) return { kind: "no-link", word: "no link: use the robot’s own button", more: "a press is kept and sent as soon as the station is back" };
  if (!state) return { kind: "no-link", word: "no state yet", more: "a press is sent at once" };
  if (silence_s > NEWS_S) return { kind: "no-link", word: `no news for ${age(silence_s)}: keep the robot’s own button at hand`, more: "the console answers and hears nothing; a press is sent at once" };
  if (!state.bus?.linked) return { kind: "no-link", word: "no bus: keep the robot’s own button at hand", more: "a press goes to the supervisor" };
  if (stopped.length) return { kind: "ready", word: "ready", more: `${names(stopped)} is stopped already; stops ${names(others)}` };
  return { kind: "ready", word: "ready", more: robots.length ? `stops ${names(robots)}` : "no robot runs here" };
}

export class Stop {
  /** @param {import("./link.js").Link} link @param {import("./desk.js").Desk} desk */
  constructor(link, desk) {
    this.link = link;
    this.desk = desk;
    this.sender = new Sender(link);
    this.handler_delay_ms = NaN;
    this.presses = 0;
    this.pressed_at = NaN;
    /** When it said what, for tests [ms]. @type {[number, string][]} */
    this.changes = [];
    /** Whether the station showed the stop that was pressed here; when it is gone again, it was released. */
    this.was_seen = false;
    this.button = byId("stop");
    this.word = byId("stop-word");
    this.more = byId("stop-robots");
    this.bar = byId("stop-bar");
    this.kind = "";

    this.release = holdButton("Release the stop", RELEASE_S, async () => {
      const answer = await link.ask("release");
      this.released_text = answer.ok ? "" : `not released: ${answer.text}`;
      this.show();
    }, "release");
    this.released_text = "";
    this.release_why = document.createElement("p");
    byId("stop-release").append(this.release, this.release_why);

    let clicked_at = -Infinity;
    const press = (/** @type {Event} */ event) => {
      this.handler_delay_ms = performance.now() - event.timeStamp;
      this.pressed_at = event.timeStamp;
      clicked_at = performance.now();
      this.presses += 1;
      this.was_seen = false;
      this.released_text = "";
      this.sender.start();
    };
    this.button.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => { if (event.button === 0) press(event); });
    this.button.addEventListener("contextmenu", (/** @type {Event} */ event) => event.preventDefault());
    this.button.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
      if ((event.key === "Enter" || event.key === " ") && !event.repeat) { event.preventDefault(); press(event); }
    });
    // A screen reader or a switch clicks without a pointer; a finger's click follows its own pointerdown.
    this.button.addEventListener("click", (/** @type {Event} */ event) => { if (performance.now() - clicked_at > 1000) press(event); });
    addEventListener("keydown", (event) => {
      const is_stop = event.key === "Pause" || (event.key === "." && (event.ctrlKey || event.metaKey));
      if (is_stop && !event.repeat) { event.preventDefault(); press(event); }
    }, true);

    this.sender.addEventListener("change", () => this.show());
    for (const change of ["state", "link", "beat"]) link.addEventListener(change, () => this.show());
    setInterval(() => this.show(), 100);
    this.show();
  }

  show() {
    const { link, sender } = this, state = link.state;
    const gates = list(state?.robots, 20).map((robot) => LATCHED.has(robot.gate));
    if (sender.press?.taken_at) {
      if (state?.stop || gates.some(Boolean)) this.was_seen = true;
      // A state that is this much younger than the press and has no stop: somebody released it before this page saw it.
      else if (this.was_seen || link.state_at - sender.press.taken_at > 1500) { sender.press = null; this.was_seen = false; }
    }
    const said = stopWord(sender.press, state, link.silence_s, link.is_up, performance.now());
    if (this.kind !== said.kind) {
      this.changes.push([performance.now(), said.kind]);
      if (this.changes.length > 30) this.changes.shift();
    }
    this.kind = said.kind;
    dress(this.bar, said.kind);
    document.documentElement.classList.toggle("is-stopped", said.kind === "stopped");
    document.documentElement.classList.toggle("is-not-taken", said.kind === "not-taken");
    write(this.word, said.word);
    write(this.more, said.more);
    const is_latched = Boolean(state?.stop) || gates.some(Boolean);
    show(byId("stop-release"), is_latched && this.desk.role === "operator");
    this.release.disabled = this.desk.why_not !== "";
    write(this.release_why, this.desk.why_not || this.released_text);
  }
}
