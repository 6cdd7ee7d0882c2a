// Each robot: its gate in words, arming, and the motion that drives it.
import { brief, byId, dress, el, keep, list, show, write } from "./dom.js";
import { OLD_S, age, rate } from "./figures.js";
import { kind } from "./gates.js";
import { holdButton } from "./hold.js";

const ARM_S = 1.2;

export class Robots {
  /** @param {import("./link.js").Link} link @param {import("./desk.js").Desk} desk */
  constructor(link, desk) {
    this.link = link;
    this.desk = desk;
    this.note = byId("robot-note");
    this.box = byId("robot-list");
    this.motion = [["Start", "motion.start"], ["Pause", "motion.pause"], ["Resume", "motion.resume"]].map(([label, what]) => {
      const button = el("button", "", label);
      button.type = "button";
      button.setAttribute("aria-label", `${label} the motion`);
      button.addEventListener("click", () => void desk.ask(this.note, what));
      byId("motion-buttons").append(button);
      return button;
    });
    for (const change of ["state", "link"]) link.addEventListener(change, () => this.show());
    link.addEventListener("beat", () => { if (!link.is_up) this.show(); });
  }

  /** @param {any} robot */
  make(robot) {
    const name = String(robot.name), card = el("div", "one");
    card.line = el("p", "line", undefined, el("b"), el("span", "gate"), el("small"));
    card.reason = el("p", "soft");
    card.arm = holdButton("Arm", ARM_S, () => void this.desk.ask(this.note, "arm", { robot: name }));
    card.arm_name = el("span", "unseen");
    card.arm.append(card.arm_name);
    card.disarm = el("button", "", "Disarm");
    card.disarm.type = "button";
    card.disarm.addEventListener("click", () => void this.desk.ask(this.note, "disarm", { robot: name }));
    card.append(card.line, card.reason, el("div", "buttons", undefined, card.arm, card.disarm));
    return card;
  }

  show() {
    const { link, desk } = this, robots = list(link.state?.robots, 8);
    keep(this.box, robots, (robot) => brief(robot.name, 120), (robot) => this.make(robot), (card, robot) => {
      const now = link.robotAge(robot), [name, gate, old] = card.line.children;
      const title = brief(robot.server || robot.name, 40);
      write(name, title);
      dress(gate, kind(String(robot.gate)));
      write(gate, brief(robot.gate, 20) || "no gate");
      write(old, now > OLD_S || Number.isNaN(now) ? Number.isNaN(now) ? "silent" : `${age(now)} old` : [robot.is_real ? "real" : "simulated", rate(robot.rate_hz)].join(" · "));
      dress(card, now <= OLD_S ? "one" : "one old");
      write(card.reason, brief(robot.reason, 160));
      const arming = brief(robot.arming, 30);
      show(card.arm, arming !== "armed");
      show(card.disarm, arming === "armed");
      show(card.arm.parentElement, arming !== "" && arming !== "none");
      write(card.arm_name, title);
      card.disarm.setAttribute("aria-label", `Disarm ${title}`);
      desk.guard(card.arm);
      desk.guard(card.disarm);
    });
    const motion = list(link.state?.servers, 60).find((server) => server.role === "motion" || server.name === "motion");
    show(byId("motion"), motion !== undefined);
    for (const button of this.motion) desk.guard(button, motion?.is_alive === false ? "the motion's server is silent" : "");
    if (!this.note.textContent || this.note.is_reason) {
      const why = desk.why_not || (robots.length ? "" : "No robot runs.");
      write(this.note, why);
      this.note.is_reason = Boolean(why);
      if (why) this.note.classList.remove("bad");
    }
  }
}
