// The socket of states, stops and requests. It is never given up: it comes back within a second of the server.
import { number } from "./dom.js";

const PING_MS = 250, LOST_MS = 750, WATCH_MS = 50, FIRST_WAIT_MS = 250, LONGEST_WAIT_MS = 1000, OPENING_MS = 3000, ANSWER_MS = 8000, MOST_KEPT = 100;
const SIGNED_OUT = 4401;  // the server's word for a sign-in that is void

/** A uuid also where the page is not a secure context (plain http on a LAN), which has no `randomUUID`. */
export function uuid() {
  const bytes = crypto.getRandomValues(new Uint8Array(16));
  return [...bytes].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

/** @param {string} path */
export const socketUrl = (path) => `${location.protocol === "https:" ? "wss" : "ws"}://${location.host}${path}`;

export class Link extends EventTarget {
  constructor() {
    super();
    /** @type {WebSocket | null} */
    this.socket = null;
    this.is_up = false;
    /** Name of the station, once the page is signed in. */
    this.station = "";
    /** Newest whole state, and when it came [ms of this page's clock]. @type {any} */
    this.state = null;
    this.state_at = -Infinity;
    /** When a robot's newest pose was measured, where a feed shows it oftener than states come [s of this page's clock]. @type {Map<string, number>} */
    this.measured_at_s = new Map();
    this.round_trip_ms = NaN;
    this.reconnects = 0;
    this.heard_at = -Infinity;
    this.opened_at = -Infinity;
    this.wait_ms = FIRST_WAIT_MS;
    this.ping = 0;
    /** @type {Map<number, number>} */
    this.pings = new Map();
    /** @type {Map<string, (answer: {ok: boolean, text: string}) => void>} */
    this.open = new Map();
    /** What came by this socket, for panels that are made later: the newest of each kind, and the events. @type {Map<string, any[]>} */
    this.came = new Map();
    this.connect();
    setInterval(() => this.beat(), PING_MS);
    setInterval(() => this.watch(), WATCH_MS);
  }

  /** Seconds since the newest state came. */
  get silence_s() { return (performance.now() - this.state_at) / 1000; }

  connect() {
    this.opened_at = performance.now();
    let socket;
    try { socket = new WebSocket(socketUrl("/ws/news")); } catch { setTimeout(() => this.connect(), LONGEST_WAIT_MS); return; }
    this.socket = socket;
    this.came.clear();
    socket.onmessage = (message) => { if (this.socket === socket) this.hear(message.data); };
    socket.onclose = (closed) => {
      if (closed.code === SIGNED_OUT) this.dispatchEvent(new Event("signed-out"));
      if (this.socket === socket) this.drop();
    };
    socket.onopen = () => { if (this.socket === socket) this.beat(); };
  }

  /** Forgets a socket that closed, or that says nothing, and opens another one. */
  drop() {
    const old = this.socket;
    this.socket = null;
    if (old) try { old.close(); } catch { /* it is gone already */ }
    this.setUp(false);
    for (const answered of this.open.values()) answered({ ok: false, text: "the link was lost before an answer came" });
    this.open.clear();
    setTimeout(() => this.connect(), this.wait_ms);
    this.wait_ms = Math.min(LONGEST_WAIT_MS, this.wait_ms * 1.5);
  }

  watch() {
    if (this.is_up && performance.now() - this.heard_at > LOST_MS) this.setUp(false);
  }

  beat() {
    const now = performance.now(), socket = this.socket;
    if (socket && !this.is_up && now - Math.max(this.opened_at, this.heard_at) > OPENING_MS) { this.drop(); return; }
    if (socket?.readyState === WebSocket.OPEN && socket.bufferedAmount < 65536) {
      this.pings.set(++this.ping, now);
      if (this.pings.size > 40) this.pings.delete(this.pings.keys().next().value ?? 0);
      socket.send(JSON.stringify({ t: "ping", id: this.ping }));
    }
    this.dispatchEvent(new Event("beat"));
  }

  /** @param {unknown} data */
  hear(data) {
    const now = performance.now();
    /** @type {any} */
    let message;
    try { message = JSON.parse(String(data)); } catch { return; }
    if (message === null || typeof message !== "object") return;
    this.heard_at = now;
    this.wait_ms = FIRST_WAIT_MS;
    if (!this.is_up) this.setUp(true);
    if (message.t === "pong") {
      const sent = this.pings.get(message.id);
      this.pings.delete(message.id);
      if (sent !== undefined) this.round_trip_ms = now - sent;
    } else if (message.t === "state") {
      this.state = message;
      this.state_at = now;
      this.dispatchEvent(new CustomEvent("state", { detail: message }));
    } else if (message.t === "answer") {
      this.open.get(message.id)?.({ ok: message.ok === true, text: String(message.text ?? "") });
      this.open.delete(message.id);
    } else if (typeof message.t === "string") {
      this.keep(message);
      this.dispatchEvent(new CustomEvent(`got-${message.t}`, { detail: message }));
    }
  }

  /** @param {any} message */
  keep(message) {
    if (message.t === "event") {
      const events = this.came.get("event") ?? [];
      events.push(message);
      if (events.length > MOST_KEPT) events.shift();
      this.came.set("event", events);
    } else if (message.t === "keys" || message.t === "episodes") this.came.set(message.t, [message]);
  }

  /**
   * Hears messages of a kind, those first that came before there was anybody to hear them.
   * @param {string} kind @param {(message: any) => void} use
   */
  on(kind, use) {
    for (const message of this.came.get(kind) ?? []) use(message);
    this.addEventListener(`got-${kind}`, (/** @type {any} */ event) => use(event.detail));
  }

  /** @param {boolean} is_up */
  setUp(is_up) {
    if (this.is_up === is_up) return;
    this.is_up = is_up;
    if (is_up) this.reconnects += 1;
    this.dispatchEvent(new Event("link"));
  }

  /** @param {object} message @returns {boolean} whether it left the page */
  send(message) {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  /**
   * Asks the server for something; the answer always comes, if need be from here.
   * @param {string} what @param {object} [fields] @returns {Promise<{ok: boolean, text: string}>}
   */
  ask(what, fields = {}) {
    const id = uuid();
    return new Promise((resolve) => {
      if (!this.is_up || !this.send({ t: "ask", id, what, ...fields })) {
        resolve({ ok: false, text: "no link to the station" });
        return;
      }
      this.open.set(id, resolve);
      setTimeout(() => {
        if (this.open.delete(id)) resolve({ ok: false, text: "the station did not answer" });
      }, ANSWER_MS);
    });
  }

  /** How old something is now that was `age_s` old when the newest state came [s]. @param {unknown} age_s */
  ageNow(age_s) { return number(age_s) + this.silence_s; }

  /** How old the newest is that this page has of a robot [s]. @param {any} robot */
  robotAge(robot) {
    const by_state = this.ageNow(robot.age_s), at_s = this.measured_at_s.get(String(robot.name));
    return at_s === undefined ? by_state : Math.min(by_state, performance.now() / 1000 - at_s);
  }
}
