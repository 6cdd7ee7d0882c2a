// The socket of poses and pictures: binary, one frame of each feed under way, and the next only after `got`. Thus a slow
// link shows fewer pictures, never older ones. It is apart from the other so that no picture delays a stop.
import { socketUrl } from "./link.js";

const FIRST_WAIT_MS = 250, LONGEST_WAIT_MS = 1000, LONGEST_HEADER = 65536, SILENT_MS = 10000;

export class Feeds extends EventTarget {
  constructor() {
    super();
    /** @type {Map<string, (header: any, payload: ArrayBuffer, offset: number) => void | Promise<void>>} */
    this.wanted = new Map();
    /** Frames that came, by feed. @type {Map<string, number>} */
    this.counts = new Map();
    /** @type {WebSocket | null} */
    this.socket = null;
    this.wait_ms = FIRST_WAIT_MS;
    this.heard_at = performance.now();
    this.connect();
    // A feed stalls for ever if a frame or its `got` was lost with a socket that never closed.
    setInterval(() => {
      if (this.wanted.size && performance.now() - this.heard_at > SILENT_MS) { this.heard_at = performance.now(); this.drop(); }
    }, 1000);
  }

  /** @param {string} feed @param {(header: any, payload: ArrayBuffer, offset: number) => void | Promise<void>} use */
  want(feed, use) {
    if (this.wanted.has(feed)) return;
    this.wanted.set(feed, use);
    this.tell();
  }

  /** @param {string} feed */
  leave(feed) {
    if (this.wanted.delete(feed)) this.tell();
  }

  tell() { this.say({ want: [...this.wanted.keys()] }); }

  /** @param {object} message @returns {boolean} whether it left the page */
  say(message) {
    if (this.socket?.readyState !== WebSocket.OPEN) return false;
    this.socket.send(JSON.stringify(message));
    return true;
  }

  connect() {
    let socket;
    try { socket = new WebSocket(socketUrl("/ws/view")); } catch { setTimeout(() => this.connect(), LONGEST_WAIT_MS); return; }
    this.socket = socket;
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      if (this.socket !== socket) return;
      this.tell();
      this.dispatchEvent(new Event("open"));
    };
    socket.onclose = () => { if (this.socket === socket) this.drop(); };
    socket.onmessage = (message) => { if (this.socket === socket) this.take(socket, message.data); };
  }

  drop() {
    const old = this.socket;
    this.socket = null;
    if (old) try { old.close(); } catch { /* it is gone already */ }
    setTimeout(() => this.connect(), this.wait_ms);
    this.wait_ms = Math.min(LONGEST_WAIT_MS, this.wait_ms * 1.5);
  }

  /** @param {WebSocket} socket @param {unknown} data */
  async take(socket, data) {
    if (!(data instanceof ArrayBuffer) || data.byteLength < 8) return;
    this.heard_at = performance.now();
    this.wait_ms = FIRST_WAIT_MS;
    const length = new DataView(data).getUint32(0, true);
    if (length > LONGEST_HEADER || 4 + length > data.byteLength) return;
    let header;
    try { header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length))); } catch { return; }
    const feed = String(header?.f ?? "");
    try {
      const use = this.wanted.get(feed);
      if (use) {
        this.counts.set(feed, (this.counts.get(feed) ?? 0) + 1);
        await use(header, data, 4 + length);
      }
    } catch (error) {
      console.warn("a frame of", feed.slice(0, 80), "was left out:", error);
    }
    if (socket.readyState === WebSocket.OPEN) socket.send(JSON.stringify({ got: feed }));
  }
}
