// The runbook: what it did, what comes, and the question that it asks a person.
import { brief, byId, dress, el, keep, list, number, show, write } from "./dom.js";
import { holdButton } from "./hold.js";

const MOST_STEPS = 80, MOST_ANSWERS = 6;
const SAID = /** @type {Record<string, string>} */ ({ done: "done", now: "now", failed: "failed", todo: "to do" });

export class Runbook {
  /** @param {import("./link.js").Link} link @param {import("./desk.js").Desk} desk */
  constructor(link, desk) {
    this.link = link;
    this.desk = desk;
    this.asked = "";
    /** @type {any[]} */
    this.answers = [];
    for (const change of ["state", "link"]) link.addEventListener(change, () => this.show());
  }

  show() {
    const runbook = this.link.state?.runbook ?? null;
    show(byId("runbook"), runbook !== null);
    write(byId("runbook-name"), brief(runbook?.name, 60));
    const steps = list(runbook?.steps, MOST_STEPS).map((step, place) => ({ ...step, place }));
    keep(byId("runbook-steps"), steps, (step) => String(step.place), () => el("li", "", undefined, el("span"), el("small"), el("i", "unseen")), (line, step) => {
      const state = Object.hasOwn(SAID, step.state) ? step.state : "todo";
      dress(line, state);
      write(line.children[0], step.text);
      write(line.children[1], brief(step.result, 160));
      line.title = brief(step.result);
      write(line.children[2], SAID[state]);
      if (state === "now") line.setAttribute("aria-current", "step"); else line.removeAttribute("aria-current");
    });
    this.question(runbook?.question ?? null);
  }

  /** @param {any} question */
  question(question) {
    const box = byId("question"), note = byId("question-note");
    show(box, question !== null);
    if (question === null) { this.asked = ""; return; }
    const hold_s = Math.min(10, Math.max(0, number(question.hold_s, 0)));
    const answers = (Array.isArray(question.answers) ? question.answers : []).slice(0, MOST_ANSWERS).map((/** @type {unknown} */ answer) => String(answer));
    const asked = JSON.stringify([String(question.id), hold_s, answers]).slice(0, 2000);
    write(byId("question-sentence"), brief(question.sentence, 600));
    if (asked !== this.asked) {
      this.asked = asked;
      const id = question.id;
      // A no leaves the robot as it is, and must never be slower than a yes.
      this.answers = answers.map((/** @type {string} */ answer, /** @type {number} */ place) => holdButton(brief(answer, 80), answer === "no" ? 0 : hold_s,
        () => void this.desk.ask(note, "runbook.answer", { question: id, answer }), place === 0 ? "primary" : ""));
      byId("question-answers").replaceChildren(...this.answers);
      write(note, "");
    }
    for (const button of this.answers) this.desk.guard(button);
    if (!note.textContent || note.is_reason) {
      write(note, this.desk.why_not);
      note.is_reason = Boolean(this.desk.why_not);
    }
  }
}
