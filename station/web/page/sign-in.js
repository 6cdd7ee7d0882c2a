// Lets a browser in by a code that is typed: a headset has no keyboard for a link.
import { byId, write } from "./dom.js";

const note = byId("pair-note");
byId("pair").addEventListener("submit", async (/** @type {Event} */ event) => {
  event.preventDefault();
  write(note, "…");
  try {
    const answer = await fetch("/pair", {
      method: "POST", cache: "no-store", headers: { "Content-Type": "application/json", "X-Station": "1" },
      body: JSON.stringify({ code: byId("code").value }),
    });
    if (answer.ok) { location.replace("/"); return; }
    write(note, (await answer.json()).error ?? `refused (${answer.status})`);
  } catch { write(note, "the station does not answer"); }
  byId("code").select();
});
