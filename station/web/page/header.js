// The line on top: which robots, in which state of their gates, what the recorder does, and how old what one sees is.
import { brief, byId, dress, el, keep, list, number, write } from "./dom.js";
import { OLD_S, age, clock } from "./figures.js";
import { kind } from "./gates.js";

export class Header {
  /** @param {import("./link.js").Link} link */
  constructor(link) {
    this.link = link;
    this.robots = byId("robots");
    for (const change of ["state", "link", "beat"]) link.addEventListener(change, () => this.show());
  }

  show() {
    const { link } = this, state = link.state;
    const name = brief(state?.runbook?.name, 40) || this.link.station || "Teleop Station";
    write(byId("station"), name);
    const robots = list(state?.robots, 8);
    keep(this.robots, robots, (robot) => brief(robot.name, 120), () => {
      const item = el("li");
      item.append(el("b"), el("span", "gate"), el("span", "arming"), el("small"));
      return item;
    }, (item, robot) => {
      const [name, gate, arming, old] = item.children;
      const now = link.robotAge(robot);
      write(name, brief(robot.server || robot.name, 40));
      name.title = brief(robot.name);
      dress(gate, kind(String(robot.gate)));
      write(gate, brief(robot.gate, 20) || "no gate");
      gate.title = brief(robot.reason);
      write(arming, brief(robot.arming, 20));
      dress(arming, `arming ${robot.arming === "armed" ? "armed" : ""}`);
      write(old, now > OLD_S || Number.isNaN(now) ? Number.isNaN(now) ? "silent" : `${age(now)} old` : robot.is_real ? "real" : "simulated");
      dress(item, now <= OLD_S ? "" : "old");
    });
    this.recorder(state?.recorder);
    this.data(robots, state);
    const slow = link.round_trip_ms > 250;
    this.gauge("link", link.is_up ? age(link.round_trip_ms / 1000) : link.state ? `lost for ${age((performance.now() - link.heard_at) / 1000)}` : "connecting",
      link.is_up ? (slow ? "warn" : "") : "bad");
    const stopped = robots.some((robot) => robot.gate === "stopped");
    document.title = `${!link.is_up ? "no link · " : stopped ? "STOPPED · " : state?.recorder?.state === "recording" ? "● " : ""}${name}`;
  }

  /** @param {any} recorder */
  recorder(recorder) {
    if (!recorder) { this.gauge("recorder", this.link.state ? "none" : "unknown", ""); return; }
    const now = this.link.silence_s;
    if (recorder.state === "recording") this.gauge("recorder", clock(number(recorder.duration_s, 0) + Math.min(now, 1)), now > OLD_S ? "recording old" : "recording");
    else this.gauge("recorder", brief(recorder.state, 20), recorder.state === "lost" ? "bad" : "");
  }

  /** Age of the oldest robot's state from end to end: it grows whatever stops, the robot, the bus, the server or the link. */
  data(/** @type {any[]} */ robots, /** @type {any} */ state) {
    if (!state) { this.gauge("data", "none", "bad"); return; }
    const air_s = number(this.link.round_trip_ms, 0) / 2000;
    const oldest = Math.max(...(robots.length ? robots.map((robot) => this.link.robotAge(robot)) : [this.link.ageNow(state.bus?.age_s)])) + air_s;
    this.gauge("data", state.bus?.linked === false ? "no bus" : Number.isNaN(oldest) ? "none" : oldest > OLD_S ? `${age(oldest)} old` : age(oldest),
      state.bus?.linked === false || !(oldest <= OLD_S) ? "bad" : "");
  }

  /** @param {string} name @param {string} value @param {string} mood */
  gauge(name, value, mood) {
    const gauge = byId(`gauge-${name}`);
    write(gauge.lastElementChild, value);
    dress(gauge, `gauge ${mood}`.trim());
  }
}
