// The socket of a page that drives. Frames go out as they are made, none is kept for later: where the line stands still, the
// station notices by their age. The station asks for this page's clock; all that it judges by is judged there.
import { socketUrl } from "/page/link.js";

const AGAIN_MS = 500, MOST_WAITING = 16384;
const SIGNED_OUT = 4401, REFUSED = 1008;

export class Line extends EventTarget {
  constructor() {
    super();
    /** @type {WebSocket | null} */
    this.socket = null;
    /** Why there is no line, in words; "" while there is one. */
    this.why = "connecting";
    this.sent = 0;
    this.left_out = 0;
    this.connect();
  }

  get is_up() { return this.socket?.readyState === WebSocket.OPEN; }

  connect() {
    const socket = new WebSocket(socketUrl("/ws/pose"));
    socket.binaryType = "arraybuffer";
    this.socket = socket;
    socket.onopen = () => this.change("");
    socket.onclose = (event) => {
      if (this.socket !== socket) return;
      this.socket = null;
      if (event.code === SIGNED_OUT) this.change("not signed in as the operator: open the link again");
      else {
        this.change(event.code === REFUSED ? "another page drives" : "no link to the station");
        setTimeout(() => this.connect(), AGAIN_MS);
      }
    };
    socket.onmessage = (message) => this.hear(socket, message.data);
  }

  /** @param {string} why */
  change(why) {
    this.why = why;
    this.dispatchEvent(new Event("change"));
  }

  /** @param {WebSocket} socket @param {unknown} data */
  hear(socket, data) {
    let said;
    try { said = JSON.parse(String(data)); } catch { return; }
    if (said?.t === "ping") socket.send(JSON.stringify({ t: "pong", id: said.id, at_ms: performance.now() }));
    else if (said?.t === "cue") this.dispatchEvent(new CustomEvent("cue", { detail: said }));
  }

  /** @param {object} message */
  say(message) {
    if (this.is_up) this.socket?.send(JSON.stringify(message));
  }

  /** @param {string} why what ended driving, in words */
  letGo(why) {
    this.say({ t: "let-go", why });
    this.dispatchEvent(new CustomEvent("let-go", { detail: why }));
  }

  /** Sends a frame, where the line takes it at once. @param {import("./frame.js").Frame} frame @param {number} taken_ms */
  send(frame, taken_ms) {
    if (!this.is_up || !this.socket) return;
    if (this.socket.bufferedAmount > MOST_WAITING) { this.left_out += 1; return; }
    this.socket.send(frame.sealed(taken_ms));
    this.sent += 1;
  }
}
