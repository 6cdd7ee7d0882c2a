// Who may do what from this page. A viewer sees all and may stop; the rest is for the operator who holds the desk.
import { brief, byId, show, write } from "./dom.js";

export class Desk {
  /** @param {import("./link.js").Link} link */
  constructor(link) {
    this.link = link;
    this.role = "viewer";
    this.is_signed_in = true;
    /** Why this page may not ask for anything; "" where it may. */
    this.why_not = "no link to the station";
    const take = byId("desk-take");
    take.addEventListener("click", async () => {
      const answer = await link.ask("desk.take");
      if (!answer.ok) write(byId("desk-words"), `Not taken: ${answer.text}`);
    });
    for (const change of ["state", "link"]) link.addEventListener(change, () => this.show());
  }

  show() {
    const desk = this.link.state?.desk ?? {};
    const holder = brief(desk.holder, 60);
    const is_operator = this.role === "operator";
    if (!this.is_signed_in) {
      this.why_not = "the sign-in of this page is void";
      show(byId("desk"), true);
      show(byId("desk-take"), false);
      write(byId("desk-words"), "The sign-in of this page is void: open a new link, which `station console` prints. Its stop goes on working.");
      return;
    }
    if (!this.link.is_up) this.why_not = "no link to the station";
    else if (!is_operator) this.why_not = "a viewer watches, and may stop";
    else if (!desk.is_mine) this.why_not = holder ? `${holder} holds the desk` : "take the desk first";
    else this.why_not = "";
    const viewers = Number(desk.viewers) || 0;
    show(byId("desk"), this.link.is_up && (!is_operator || !desk.is_mine));
    show(byId("desk-take"), is_operator && !desk.is_mine);
    const watching = viewers > 1 ? `, ${viewers} pages watch` : "";
    write(byId("desk-words"), !is_operator ? `You watch as a viewer and may stop${holder ? `; ${holder} holds the desk` : ""}${watching}.`
      : `${holder ? `${holder} holds the desk` : "Nobody holds the desk"}${watching}.`);
  }

  /**
   * Asks, and says what came of it in a panel's note.
   * @param {any} note @param {string} what @param {object} [fields]
   */
  async ask(note, what, fields = {}) {
    const answer = await this.link.ask(what, fields);
    write(note, answer.ok ? answer.text : `Refused: ${answer.text}`);
    note.classList.toggle("bad", !answer.ok);
    clearTimeout(note.timer);
    note.timer = setTimeout(() => write(note, ""), answer.ok ? 6000 : 15000);
    return answer.ok;
  }

  /** Disables a button with the reason in its title. @param {any} button @param {string} [why_not] of its own */
  guard(button, why_not = "") {
    const reason = this.why_not || why_not;
    if (button.disabled !== Boolean(reason)) button.disabled = Boolean(reason);
    if (button.title !== reason) button.title = reason;
  }
}
