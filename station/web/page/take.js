// A take: record, mark, keep it as a success or a failure, or discard it.
import { brief, byId, dress, el, number, show, write } from "./dom.js";
import { OLD_S, clock, size, thousands } from "./figures.js";
import { holdButton } from "./hold.js";

export class Take {
  /** @param {import("./link.js").Link} link @param {import("./desk.js").Desk} desk */
  constructor(link, desk) {
    this.link = link;
    this.desk = desk;
    const note = byId("take-note"), buttons = byId("take-buttons");
    const task = byId("take-task"), instruction = byId("take-instruction");
    try { task.value = localStorage.getItem("task") ?? ""; instruction.value = localStorage.getItem("instruction") ?? ""; } catch { /* no storage: empty */ }
    const button = (/** @type {string} */ label, /** @type {string} */ kind, /** @type {() => void} */ act) => {
      const made = el("button", kind, label);
      made.type = "button";
      made.addEventListener("click", act);
      return made;
    };
    this.record = button("Record", "primary", () => {
      try { localStorage.setItem("task", task.value); localStorage.setItem("instruction", instruction.value); } catch { /* not kept */ }
      void desk.ask(note, "record.start", { task: task.value.trim(), instruction: instruction.value.trim() });
    });
    this.mark = button("Mark", "", () => void desk.ask(note, "record.mark", { label: "console" }));
    this.success = button("Keep: success", "good", () => void desk.ask(note, "record.stop", { success: true }));
    this.failure = button("Keep: failure", "", () => void desk.ask(note, "record.stop", { success: false }));
    this.discard = holdButton("Discard", 0.6, () => void desk.ask(note, "record.discard", { reason: "console" }), "danger");
    buttons.append(this.record, this.success, this.failure, this.mark, this.discard);
    task.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => { if (event.key === "Enter") this.record.click(); });
    for (const change of ["state", "link", "beat"]) link.addEventListener(change, () => this.show());
  }

  show() {
    const { link, desk } = this, recorder = link.state?.recorder, takes = link.state?.takes ?? {};
    const is_recording = recorder?.state === "recording", old = link.silence_s > OLD_S;
    const none = recorder ? "" : "no recorder runs";
    show(byId("take-idle"), !is_recording);
    show(byId("take-running"), is_recording);
    show(this.record, !is_recording);
    for (const button of [this.mark, this.success, this.failure, this.discard]) { show(button, is_recording); desk.guard(button, none); }
    desk.guard(this.record, none || (recorder?.state === "lost" ? brief(recorder.error) || "the recorder is lost" : ""));
    byId("take").classList.toggle("recording", is_recording);
    if (is_recording) {
      write(byId("take-clock"), clock(number(recorder.duration_s, 0) + Math.min(link.silence_s, 1)));
      dress(byId("take-clock"), old ? "big old" : "big");
      const lost = number(recorder.dropped, 0);
      write(byId("take-counts"), [brief(recorder.task, 60), `${thousands(recorder.messages)} messages`, size(recorder.bytes), lost ? `${thousands(lost)} DROPPED` : "none dropped"].filter(Boolean).join(" · "));
    }
    const disk = number(recorder?.free_gb), minutes = number(recorder?.minutes_left);
    const last = brief(takes.last, 30);
    write(byId("take-figures"), [`${number(takes.last_hour, 0)} in the last hour`, last && `last ${last}`, minutes < 600 ? `${Math.round(minutes)} min of disk left` : Number.isNaN(disk) ? "" : `${disk < 100 ? disk.toFixed(1) : Math.round(disk)} GB free`].filter(Boolean).join(" · "));
    const note = byId("take-note");
    if (!note.textContent || note.is_reason) {
      const why = none && link.is_up ? none : desk.why_not || brief(recorder?.error, 160);
      write(note, why);
      note.is_reason = Boolean(why);
      if (why) note.classList.remove("bad");
    }
  }
}
