// A page that drives: a headset's session where the browser has WebXR, thumbs where it has not, the stop in any case.
import { brief, byId, el, dress, show, write } from "/page/dom.js";
import { Sender } from "/page/stop.js";
import { Headset, modeOf } from "./headset.js";
import { Line } from "./line.js";
import { Pictures } from "./pictures.js";
import { Touch } from "./touch.js";

const MOST_CUES = 4, NOT_TAKEN_MS = 350;
const MODES = { "immersive-ar": "Enter, with the room in view", "immersive-vr": "Enter" };
/** What a pad is for, by whether the phone is itself the hand: on it, and as it is read out. */
const PADS = {
  "pad-left": [["hold to drive", "Left stick; it drives only while it is held"], ["hold to move", "The robot follows the phone only while this is held"]],
  "pad-right": [["turn", "Right stick"], ["hold to close", "The hand closes while this is held"]],
};

const answer = await fetch("/api/me", { cache: "no-store" });
const me = answer.ok ? await answer.json() : { stop_key: "", eyes: [] };

const line = new Line();
const pictures = new Pictures(Array.isArray(me.eyes) ? me.eyes.map(String) : []);
const touch = new Touch(line, byId("pad-left"), byId("pad-right"), () => headset.session === null);
const headset = new Headset(line, pictures, byId("scene"), touch);

const cues = byId("cues");
/** @param {string} words @param {boolean} is_urgent */
function tell(words, is_urgent) {
  cues.prepend(el("li", is_urgent ? "urgent" : "", brief(words, 120)));
  while (cues.childElementCount > MOST_CUES) cues.lastElementChild.remove();
}
line.addEventListener("cue", (/** @type {any} */ event) => {
  tell(event.detail.words, event.detail.urgent === true);
  headset.scene?.say(brief(event.detail.words, 120), event.detail.urgent === true);
  if (headset.session === null || headset.is_phone) navigator.vibrate?.(event.detail.urgent === true ? 400 : 60);
});
line.addEventListener("let-go", (/** @type {any} */ event) => tell(`let go: ${event.detail}`, false));
line.addEventListener("change", () => {
  write(byId("link"), line.why || "up");
  byId("link").parentElement.className = line.why ? "gauge bad" : "gauge";
  if (line.why) headset.scene?.say(line.why, true);
});

const enter = byId("enter"), mode = await modeOf();
const why_none = isSecureContext ? "This browser has no WebXR with a headset; the pads below drive."
  : "WebXR needs https, or a cable and http://localhost; the pads below drive.";
const showHeadset = () => {
  const in_hand = Boolean(headset.session) && headset.is_phone;
  write(byId("headset-words"), in_hand ? "This phone is the robot’s right hand." : headset.session ? "In the headset." : mode ? "This browser has WebXR." : why_none);
  show(enter, in_hand || (Boolean(mode) && !headset.session));
  write(enter, in_hand ? "Leave" : MODES[mode] ?? "");
  document.documentElement.classList.toggle("in-hand", in_hand);
  for (const [id, names] of Object.entries(PADS)) {
    const [shown, read] = names[Number(in_hand)], pad = byId(id);
    pad.setAttribute("aria-label", read);
    write(/** @type {HTMLElement} */ (pad.querySelector("b")), shown);
  }
};
enter.addEventListener("click", async () => {
  if (headset.session) { headset.session.end(); return; }
  enter.disabled = true;
  try { await headset.enter(mode); } catch (error) { tell(`no session: ${error instanceof Error ? error.message : error}`, true); }
  enter.disabled = false;
  showHeadset();
});
headset.addEventListener("change", showHeadset);
if (!mode) { touch.begin(); byId("main").classList.add("no-headset"); }
showHeadset();

/** @type {any} */
let lock = null;
touch.addEventListener("change", async () => {
  write(byId("touch-words"), touch.is_held ? "held" : "not held");
  if (touch.is_held && !lock) try { lock = await /** @type {any} */ (navigator).wakeLock?.request("screen"); lock?.addEventListener("release", () => { lock = null; }); } catch { lock = null; }
});

let sent = 0;
setInterval(() => {
  const late = line.left_out ? `, ${line.left_out} left out` : "";
  write(byId("rate"), line.sent === sent ? "none" : `${line.sent - sent} Hz${late}`);
  sent = line.sent;
}, 1000);

// The stop goes by POST alone: the socket of poses carries nothing that must not be late.
const nobody = Object.assign(new EventTarget(), { send: () => false });
const sender = new Sender(/** @type {any} */ (nobody));
sender.me.key = String(me.stop_key ?? "");
const button = byId("stop"), bar = byId("stop-bar");
const press = () => sender.start();
button.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => { if (event.button === 0) press(); });
button.addEventListener("click", () => { if (!sender.press || sender.press.taken_at) press(); });
addEventListener("keydown", (event) => {
  if ((event.key === "Pause" || (event.key === "." && (event.ctrlKey || event.metaKey))) && !event.repeat) { event.preventDefault(); press(); }
}, true);
const showStop = () => {
  const found = sender.press;
  const kind = !found ? "ready" : found.taken_at ? "taken" : performance.now() - found.at < NOT_TAKEN_MS ? "stopping" : "not-taken";
  const words = { ready: "ready", taken: "taken", stopping: "stopping…", "not-taken": "NOT TAKEN: use the robot’s own button" };
  dress(bar, kind);
  write(byId("stop-word"), words[kind]);
  write(byId("stop-robots"), found?.text ?? "");
};
sender.addEventListener("change", showStop);
setInterval(showStop, 100);

/** For tests. */
/** @type {any} */ (window).drivePage = { line, headset, touch, pictures, sender, is_ready: true };
