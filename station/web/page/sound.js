// A short tone, and a phone that vibrates, for each new alarm of level error; STOPPED has a tone of its own. Off until it is
// switched on: browsers give no sound before they were touched.
import { brief, byId, list, write } from "./dom.js";

const MOST_ALARMS = 8, AGAIN_MS = 10000, LINK_LOST_MS = 2000, VOLUME = 0.25;
/** Of each tone: its parts as frequency, from, to [s]; and how a phone vibrates, on and off [ms]. */
const TONES = /** @type {Record<string, {parts: [number, number, number][], vibrates: number[]}>} */ ({
  error: { parts: [[880, 0, 0.14], [880, 0.22, 0.36]], vibrates: [180, 80, 180] },
  stop: { parts: [[660, 0, 0.25], [440, 0.25, 0.5], [330, 0.5, 0.9]], vibrates: [700] },
});

export class Sound {
  /** @param {import("./link.js").Link} link */
  constructor(link) {
    this.link = link;
    this.button = byId("sound");
    this.is_on = false;
    try { this.is_on = localStorage.getItem("sound") === "on"; } catch { /* off */ }
    /** @type {AudioContext | null} */
    this.audio = null;
    /** Tones that were to sound, and those that were heard to their end. @type {Record<string, number>} */
    this.begun = { error: 0, stop: 0 };
    this.ended = 0;
    this.vibrated = 0;
    /** When each alarm was there last [ms of this page's clock]; one that comes back at once is not new. @type {Map<string, number>} */
    this.known = new Map();
    this.is_first = true;
    /** What was new last. */
    this.newest = "";
    this.button.addEventListener("click", () => this.switch());
    for (const touch of ["pointerdown", "keydown"]) document.addEventListener(touch, () => { if (this.is_on) this.wake(); }, { capture: true, passive: true });
    for (const change of ["state", "beat"]) link.addEventListener(change, () => this.look());
    link.on("event", (event) => { if (event.name === "fall" && !event.is_old) this.sound("error"); });
    this.show();
  }

  switch() {
    this.is_on = !this.is_on;
    try { localStorage.setItem("sound", this.is_on ? "on" : "off"); } catch { /* not kept */ }
    if (this.is_on) { this.wake(); this.play("error"); }  // so that one hears what it will be
    this.show();
  }

  /** A browser lets a page sound only after a touch. */
  wake() {
    try {
      this.audio ??= new AudioContext();
      if (this.audio.state === "suspended") void this.audio.resume().then(() => this.show(), () => {});
    } catch { this.audio = null; }
    this.show();
  }

  /** Finds what is new. */
  look() {
    const { state } = this.link;
    if (!state) return;
    const robots = list(state.robots, 8), stopped = robots.filter((robot) => robot.gate === "stopped").map((robot) => `stopped ${brief(robot.name, 120)}`);
    const errors = list(state.alarms, MOST_ALARMS).filter((alarm) => alarm.level === "error" && !(alarm.is_stop && robots.length)).map((alarm) => brief(alarm.text).replace(/[\d.]+/g, "#"));
    if (performance.now() - this.link.heard_at > LINK_LOST_MS) errors.push("no link");  // a line that stutters is no alarm
    const has_stopped = this.isNew(stopped), has_failed = this.isNew(errors);
    if (!this.is_first && (has_stopped || has_failed)) this.sound(has_stopped ? "stop" : "error");
    this.is_first = false;  // what stood before the page came is no news
  }

  /** Whether any of these was not there lately. @param {string[]} alarms */
  isNew(alarms) {
    const now = performance.now();
    for (const [alarm, at] of this.known) if (now - at > AGAIN_MS) this.known.delete(alarm);
    const is_new = alarms.some((alarm) => !this.known.has(alarm));
    if (is_new) this.newest = alarms.filter((alarm) => !this.known.has(alarm)).join("; ");
    for (const alarm of alarms) this.known.set(alarm, now);
    return is_new;
  }

  /** @param {string} tone */
  sound(tone) {
    if (!this.is_on) return;
    this.play(tone);
    try { if (navigator.vibrate?.(TONES[tone].vibrates)) this.vibrated += 1; } catch { /* it cannot */ }
  }

  /** @param {string} tone */
  play(tone) {
    this.begun[tone] += 1;
    const { audio } = this;
    if (!audio || audio.state === "closed") return;
    const gain = audio.createGain();
    gain.gain.value = VOLUME;
    gain.connect(audio.destination);
    const { parts } = TONES[tone];
    parts.forEach(([hz, from_s, to_s], place) => {
      const part = audio.createOscillator();
      part.frequency.value = hz;
      part.connect(gain);
      part.start(audio.currentTime + from_s);
      part.stop(audio.currentTime + to_s);
      if (place === parts.length - 1) part.onended = () => { this.ended += 1; gain.disconnect(); };
    });
  }

  show() {
    const is_waiting = this.is_on && this.audio?.state !== "running";
    write(this.button, !this.is_on ? "sound off" : is_waiting ? "touch for sound" : "sound on");
    this.button.setAttribute("aria-label", `${this.button.textContent}: tone and vibration of alarms`);
  }
}
