// Puts the page together. The stop comes first, so that nothing that fails later is in its way.
import { brief, byId, write } from "./dom.js";
import { Desk } from "./desk.js";
import { Link } from "./link.js";
import { Stop } from "./stop.js";

const link = new Link();
const desk = new Desk(link);
const stop = new Stop(link, desk);

/** @type {any} */
const parts = {};
const SIGN_IN_AGAIN_MS = 2000;

/** Who this page is to the station; asked until it answers, for a page that was opened before the server. */
async function signIn() {
  try {
    const answer = await fetch("/api/me", { cache: "no-store", signal: AbortSignal.timeout?.(3000) });
    if (answer.status === 401) throw new Error("not signed in");
    const me = await answer.json();
    stop.sender.me = { key: String(me.stop_key ?? "") };
    desk.role = me.role === "operator" ? "operator" : "viewer";
    link.station = brief(me.station, 60);
    write(byId("station"), link.station || "Teleop Station");
    byId("station").title = `Teleop Station ${brief(me.version, 40)}, as ${desk.role}`;
    desk.is_signed_in = true;
    desk.show();
  } catch {
    setTimeout(signIn, SIGN_IN_AGAIN_MS);
  }
}
void signIn();
link.addEventListener("signed-out", () => { desk.is_signed_in = false; desk.show(); });

/** A summary for tests in a browser; it changes nothing. */
Object.defineProperty(window, "stationPage", {
  value: Object.freeze({
    get stop() {
      const press = stop.sender.press;
      return { kind: stop.kind, word: byId("stop-word").textContent, more: byId("stop-robots").textContent, presses: stop.presses, tries: stop.sender.tries, is_taken: Boolean(press?.taken_at), id: press?.id ?? "", handler_delay_ms: stop.handler_delay_ms, pressed_at: stop.pressed_at, changes: stop.changes.map((change) => [...change]) };
    },
    get link() { return { is_up: link.is_up, round_trip_ms: link.round_trip_ms, silence_s: link.silence_s, reconnects: link.reconnects, heard_ms: performance.now() - link.heard_at }; },
    get state() { return link.state ? structuredClone(link.state) : null; },
    /** Whether every panel was made. */
    get is_ready() { return "playback" in parts; },
    get is_known() { return stop.sender.me.key !== ""; },
    get role() { return desk.role; },
    get why_not() { return desk.why_not; },
    get frames() { return Object.fromEntries(parts.feeds?.counts ?? []); },
    /** What is shown of an episode; null where what is shown is live. */
    get playback() { return parts.playback?.summary ?? null; },
    /** Tones that were begun and ended, and how often it vibrated. */
    get sound() { return { is_on: parts.sound?.is_on ?? false, ...parts.sound?.begun, ended: parts.sound?.ended ?? 0, newest: parts.sound?.newest ?? "", vibrated: parts.sound?.vibrated ?? 0, is_awake: parts.sound?.audio?.state === "running" }; },
    get drawn() { return { scene: parts.view?.frames ?? 0, draw_ms: parts.view?.draw_ms ?? NaN, curves: parts.curves?.drawn ?? 0 }; },
  }),
});

/** A panel that cannot be made is missing, and the others are there. @param {string} name @param {() => Promise<any>} make */
async function part(name, make) {
  try { parts[name] = await make(); } catch (error) { console.error(`the panel ${name} is missing:`, error); }
}

// All are fetched at once, and made in this order.
const [header, panels, take, robots, runbook, episodes, feeds, cameras, view, curves, playback, sound] = [
  "header", "panels", "take", "robot", "runbook", "episodes", "feeds", "cameras", "view3d", "curves", "playback", "sound",
].map((name) => {
  const module = import(`./${name}.js`);
  module.catch(() => {});  // said where it is made
  return module;
});
await part("header", async () => new (await header).Header(link));
await part("sound", async () => new (await sound).Sound(link));
await part("lists", async () => {
  const { showAlarms, showServers, showKeys, showEvents } = await panels;
  for (const shown of [showAlarms, showServers, showKeys, showEvents]) shown(link);
});
await part("take", async () => new (await take).Take(link, desk));
await part("robots", async () => new (await robots).Robots(link, desk));
await part("runbook", async () => new (await runbook).Runbook(link, desk));
await part("episodes", async () => new (await episodes).Episodes(link, (/** @type {string} */ id, /** @type {any} */ opener) => parts.playback?.open(id, opener)));
await part("feeds", async () => new (await feeds).Feeds());
await part("cameras", async () => new (await cameras).Cameras(link, parts.feeds));
await part("view", async () => new (await view).View3d(link, parts.feeds));
await part("curves", async () => new (await curves).Curves(parts.view));
await part("playback", async () => new (await playback).Playback(parts.feeds, parts.view, parts.cameras, parts.curves));
if (link.state) link.dispatchEvent(new CustomEvent("state", { detail: link.state }));

// Bands that come and go on top take their height from the columns below, so that these still end above the stop.
for (const [id, name] of [["bands", "--bands"], ["playback", "--playback"]]) {
  const band = byId(id);
  new ResizeObserver(() => document.documentElement.style.setProperty(name, `${band.offsetHeight}px`)).observe(band);
}

/** Keeps the screen on where the browser may (a secure origin). */
async function stayAwake() {
  if (!document.hidden) try { await navigator.wakeLock?.request("screen"); } catch { /* it may sleep then */ }
}
document.addEventListener("visibilitychange", stayAwake);
void stayAwake();
