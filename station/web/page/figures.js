// Numbers as people read them. Every one has an age, and one older than a second says so.
import { number } from "./dom.js";

export const OLD_S = 1.0;

/** @param {number} seconds */
export function age(seconds) {
  const s = number(seconds);
  if (Number.isNaN(s)) return "never";
  if (s < 1) return `${Math.max(0, Math.round(s * 1000))} ms`;
  if (s < 60) return `${s.toFixed(1)} s`;
  if (s < 3600) return `${Math.floor(s / 60)} min`;
  return s < 86400 ? `${Math.floor(s / 3600)} h` : `${Math.floor(s / 86400)} d`;
}

/** @param {unknown} hz */
export function rate(hz) {
  const r = number(hz);
  if (Number.isNaN(r)) return "";
  return r >= 100 ? `${Math.round(r)} Hz` : r > 0 && r < 1 ? `${r.toFixed(2)} Hz` : `${r.toFixed(r < 10 ? 1 : 0)} Hz`;
}

/** @param {unknown} seconds minutes and seconds of a recording */
export function clock(seconds) {
  const s = Math.max(0, number(seconds, 0));
  const minutes = Math.floor(s / 60), hours = Math.floor(minutes / 60);
  const tail = `${String(minutes % 60).padStart(hours ? 2 : 1, "0")}:${String(Math.floor(s % 60)).padStart(2, "0")}`;
  return hours ? `${hours}:${tail}` : tail;
}

/** @param {unknown} seconds an instant of an episode, to the hundredth; one before its start has a minus */
export function moment(seconds) {
  const hundredths = Math.round(Math.abs(number(seconds, 0)) * 100), minutes = Math.floor(hundredths / 6000);
  return `${number(seconds, 0) < 0 && hundredths ? "−" : ""}${minutes}:${((hundredths % 6000) / 100).toFixed(2).padStart(5, "0")}`;
}

/** @param {unknown} bytes */
export function size(bytes) {
  const b = number(bytes);
  if (Number.isNaN(b)) return "";
  if (b < 1e3) return `${b} B`;
  if (b < 1e6) return `${(b / 1e3).toFixed(0)} kB`;
  if (b < 1e9) return `${(b / 1e6).toFixed(1)} MB`;
  return `${(b / 1e9).toFixed(1)} GB`;
}

/** @param {unknown} count */
export const thousands = (count) => (Number.isNaN(number(count)) ? "" : Math.round(number(count)).toLocaleString("en").replace(/,/g, " "));

/** When something began, as people say it. @param {unknown} started a time that `Date` reads */
export function when(started) {
  const at = new Date(typeof started === "string" || typeof started === "number" ? started : NaN);
  if (Number.isNaN(at.getTime())) return String(started ?? "").slice(0, 24);
  const time = at.toTimeString().slice(0, 5);
  return at.toDateString() === new Date().toDateString() ? time : `${at.toISOString().slice(5, 10)} ${time}`;
}

/** Words for a name on the bus: `left_hip_pitch` is "left hip pitch". @param {unknown} name */
export const words = (name) => String(name ?? "").slice(0, 400).replace(/_joint$/, "").replace(/_/g, " ").trim();
