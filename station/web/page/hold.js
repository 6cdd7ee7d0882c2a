// A button that acts only when it was held: what moves a robot must not be done by a brush of a sleeve.
import { el } from "./dom.js";

/**
 * @param {string} label @param {number} hold_s @param {() => void} act @param {string} [kind] classes
 * @returns {any} the button; `button.hold_s` may be changed
 */
export function holdButton(label, hold_s, act, kind = "") {
  const button = el("button", `hold ${kind}`.trim());
  button.type = "button";
  const ring = el("i", "ring");
  ring.setAttribute("aria-hidden", "true");
  const words = el("span", "", label);
  const how = el("small", "", hold_s > 0 ? `hold ${hold_s} s` : "");
  if (hold_s > 0) button.append(ring, words, how); else button.append(words);
  let began = 0, frame = 0;

  const stopHolding = () => {
    began = 0;
    cancelAnimationFrame(frame);
    button.style.setProperty("--held", "0");
    button.classList.remove("held");
  };
  const turn = () => {
    if (!began) return;
    if (button.disabled) { stopHolding(); return; }
    const part = (performance.now() - began) / (hold_s * 1000);
    button.style.setProperty("--held", String(Math.min(1, part)));
    if (part >= 1) { stopHolding(); act(); } else frame = requestAnimationFrame(turn);
  };
  const start = () => {
    if (began || button.disabled) return;
    if (hold_s <= 0) { act(); return; }
    began = performance.now();
    button.classList.add("held");
    frame = requestAnimationFrame(turn);
  };

  button.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => { if (event.button === 0 && event.isPrimary) start(); });
  for (const end of ["pointerup", "pointerleave", "pointercancel", "blur"]) button.addEventListener(end, stopHolding);
  button.addEventListener("contextmenu", (/** @type {Event} */ event) => event.preventDefault());  // a long touch
  button.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
    if (event.key !== " " && event.key !== "Enter") { if (event.key === "Escape") stopHolding(); return; }
    event.preventDefault();
    if (!event.repeat) start();
  });
  button.addEventListener("keyup", (/** @type {KeyboardEvent} */ event) => { if (event.key === " " || event.key === "Enter") stopHolding(); });
  document.addEventListener("visibilitychange", () => { if (document.hidden) stopHolding(); });
  return button;
}
