// What was asked of some joints and what they did, over the last 20 s, with the gate's states behind.
import uPlot from "./vendor/uplot.js";
import { brief, byId, el, show, write } from "./dom.js";
import { words } from "./figures.js";
import { COLOURS } from "./gates.js";
import { byLimb } from "./joint_groups.js";

const SPAN_S = 20, DRAW_MS = 100, MOST_FRAMES = SPAN_S * 65, MOST_CHOSEN = 4, FIRST_CHOSEN = 3, LEAST_SPAN_RAD = 0.1, CHOOSE_AFTER_S = 2, GAP_S = 0.5, STILL_RAD = 0.1;

export class Curves {
  /** @param {import("./view3d.js").View3d} view */
  constructor(view) {
    this.box = byId("curve-list");
    this.picker = byId("joint-list");
    /** @type {string[]} */
    this.joints = [];
    /** @type {{at_s: number, q: Float32Array, command: Float32Array | null, gate: string}[]} */
    this.frames = [];
    /** @type {number[]} */
    this.chosen = [];
    /** @type {{joint: number, plot: any, value: any, node: any}[]} */
    this.rows = [];
    this.drawn = 0;
    /** Joints that somebody chose, also while none of them is there. @type {string[]} */
    this.own_choice = [];
    this.looked_s = -Infinity;
    /** What time it is on the curves' axis [s]: now, or where an episode is. */
    this.clock = () => performance.now() / 1000;
    this.zero = "now";
    view.addEventListener("robot", (/** @type {any} */ event) => this.setRobot(event.detail));
    view.addEventListener("joints", (/** @type {any} */ event) => this.add(event.detail));
    document.addEventListener("theme", () => this.rebuild());
    new ResizeObserver(() => this.resize()).observe(this.box);
    setInterval(() => this.draw(), DRAW_MS);
    const details = byId("joints");
    details.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => { if (event.key === "Escape") { details.open = false; details.firstElementChild.focus(); } });
    document.addEventListener("pointerdown", (event) => { if (details.open && !details.contains(event.target)) details.open = false; });
  }

  /** @param {any} scene */
  setRobot(scene) {
    this.joints = scene.joints;
    this.unit = brief(scene.unit, 8) || "rad";
    this.frames = [];
    this.looked_s = -Infinity;
    this.choose(this.own_choice.map((name) => this.joints.indexOf(name)).filter((joint) => joint >= 0));
    this.makePicker();
  }

  /** What was before, after time jumped. @param {any[]} frames in order */
  setPast(frames) {
    this.frames = [];
    this.looked_s = -Infinity;
    for (const frame of frames) this.add(frame);
  }

  /** @param {any} frame */
  add(frame) {
    if (!frame.q || frame.q.length !== this.joints.length) return;
    const last = this.frames.at(-1);
    if (last && frame.at_s <= last.at_s) return;
    this.frames.push(frame);
    const first_s = frame.at_s - SPAN_S - 0.5;
    while (this.frames.length > MOST_FRAMES || this.frames[0].at_s < first_s) this.frames.shift();
    if (!this.own_choice.length && frame.at_s - this.looked_s > CHOOSE_AFTER_S && frame.at_s - this.frames[0].at_s > CHOOSE_AFTER_S) this.chooseItself(frame.at_s);
  }

  /** Shows the joints that move; stays with those that it shows for as long as they do. @param {number} now_s */
  chooseItself(now_s) {
    this.looked_s = now_s;
    const reach = this.reach(), turned = new Map(reach.map((one) => [one.joint, one.turned]));
    const is_still = this.chosen.every((joint) => (turned.get(joint) ?? 0) < STILL_RAD);
    if (is_still && (!this.chosen.length || (reach[0]?.turned ?? 0) > 2 * STILL_RAD)) this.choose(this.mostMoving());
  }

  /** How far each joint turned lately, the furthest first [rad]. */
  reach() {
    return this.joints.map((_, joint) => {
      let low = Infinity, high = -Infinity;
      for (const { q } of this.frames) { if (q[joint] < low) low = q[joint]; if (q[joint] > high) high = q[joint]; }
      return { joint, turned: high >= low ? high - low : -1 };
    }).filter(({ turned }) => turned >= 0).sort((a, b) => b.turned - a.turned);
  }

  mostMoving() { return this.reach().slice(0, FIRST_CHOSEN).map(({ joint }) => joint); }

  makePicker() {
    const most = el("button", "", "The most moving");
    most.type = "button";
    most.addEventListener("click", () => { this.own_choice = []; this.choose(this.mostMoving()); });
    const groups = [...byLimb(this.joints)].map(([limb, places]) => {
      const group = el("fieldset", "", undefined, el("legend", "", limb));
      for (const place of places) {
        const box = el("input");
        box.type = "checkbox";
        box.value = String(place);
        box.addEventListener("change", () => {
          this.choose(box.checked ? [...this.chosen, place].slice(-MOST_CHOSEN) : this.chosen.filter((other) => other !== place));
          this.own_choice = this.chosen.map((joint) => this.joints[joint]);
        });
        const name = words(this.joints[place]), side = limb.toLowerCase().split(" ")[0];
        group.append(el("label", "", undefined, box, el("span", "", limb.includes(" ") && name.startsWith(`${side} `) ? name.slice(side.length + 1) : name)));
      }
      return group;
    });
    this.picker.replaceChildren(el("p", "soft", `Up to ${MOST_CHOSEN}.`), most, el("div", "limbs", undefined, ...groups));
  }

  /** @param {number[]} joints */
  choose(joints) {
    this.chosen = joints;
    for (const box of this.picker.querySelectorAll("input")) box.checked = joints.includes(Number(box.value));
    this.rebuild();
  }

  rebuild() {
    for (const { plot } of this.rows) plot.destroy();
    const style = getComputedStyle(document.documentElement), colour = (/** @type {string} */ name) => style.getPropertyValue(name).trim();
    const soft = colour("--soft"), faint = colour("--grid-line"), font = `11px ${style.getPropertyValue("--font").trim() || "sans-serif"}`;
    this.band_alpha = document.documentElement.dataset.theme === "dark" ? 0.17 : 0.55;
    this.box.replaceChildren();
    this.rows = this.chosen.map((joint, place) => {
      const node = el("div", "curve"), value = el("span", "n");
      node.append(el("p", "", undefined, el("b", "", words(this.joints[joint])), value));
      this.box.append(node);
      const is_last = place === this.chosen.length - 1;
      const axis = { stroke: soft, font, ticks: { show: false }, grid: { stroke: faint, width: 1 } };
      const plot = new uPlot({
        width: 300, height: 80, padding: [6, 14, is_last ? 0 : 6, 0], legend: { show: false }, cursor: { show: false },
        scales: {
          x: { time: false, range: () => [-SPAN_S, 0] },
          y: { range: (/** @type {any} */ _, /** @type {number} */ low, /** @type {number} */ high) => {
            if (!Number.isFinite(low) || !Number.isFinite(high)) return [-1, 1];
            const middle = (low + high) / 2, half = (Math.max(high - low, LEAST_SPAN_RAD) / 2) * 1.12;
            return [middle - half, middle + half];
          } },
        },
        axes: [
          { ...axis, size: is_last ? 22 : 0, show: is_last, space: 60, values: (/** @type {any} */ _, /** @type {number[]} */ at) => at.map((s) => (s === 0 ? this.zero : `${s} s`)) },
          { ...axis, size: 40, space: 26 },
        ],
        series: [
          {},
          { stroke: colour("--asked"), width: 3, dash: [7, 4], points: { show: false } },
          { stroke: colour("--state"), width: 1.5, points: { show: false } },
        ],
        hooks: { drawClear: [(/** @type {any} */ u) => this.shade(u)] },
      }, [[], [], []], node);
      return { joint, plot, value, node };
    });
    show(byId("curves-words"), this.chosen.length === 0);
    this.resize();
    this.draw(true);
  }

  /** Bands of the gate, in the colours of a report's lane. @param {any} u */
  shade(u) {
    const { ctx, bbox } = u, now_s = this.now_s ?? 0;
    ctx.save();
    ctx.globalAlpha = this.band_alpha;
    let from = 0;
    for (let i = 1; i <= this.frames.length; i += 1) {
      const first = this.frames[from];
      if (i < this.frames.length && this.frames[i].gate === first.gate && this.frames[i].at_s - this.frames[i - 1].at_s < GAP_S) continue;
      const is_joined = i < this.frames.length && this.frames[i].at_s - this.frames[i - 1].at_s < GAP_S;
      const end = this.frames[is_joined ? i : i - 1].at_s;
      const left = Math.max(bbox.left, u.valToPos(first.at_s - now_s, "x", true)), right = Math.min(bbox.left + bbox.width, u.valToPos(end - now_s, "x", true));
      const colour = Object.hasOwn(COLOURS, first.gate) ? COLOURS[first.gate] : null;
      if (colour && right > left) { ctx.fillStyle = colour; ctx.fillRect(left, bbox.top, right - left, bbox.height); }
      from = i;
    }
    ctx.restore();
  }

  resize() {
    const count = this.rows.length || 1, width = this.box.clientWidth;
    const tall = Math.max(74, Math.min(150, Math.floor((this.box.clientHeight || 280) / count) - 20));
    if (width) for (const { plot } of this.rows) plot.setSize({ width, height: tall });
  }

  draw(is_forced = false) {
    const { frames } = this;
    if (!this.rows.length || !frames.length || (document.hidden && !is_forced)) return;
    this.now_s = this.clock();
    const times = new Array(frames.length);
    for (let i = 0; i < frames.length; i += 1) times[i] = frames[i].at_s - this.now_s;
    // Nothing is drawn across a hole in the data as if it had been measured.
    const known = (/** @type {number} */ value, /** @type {number} */ i) => (Number.isFinite(value) && !(i > 0 && times[i] - times[i - 1] > GAP_S) ? value : null);
    for (const { joint, plot, value } of this.rows) {
      plot.setData([times, frames.map((frame, i) => known(frame.command ? frame.command[joint] : NaN, i)), frames.map((frame, i) => known(frame.q[joint], i))]);
      const last = frames[frames.length - 1], off = last.command ? last.command[joint] - last.q[joint] : NaN;
      write(value, -times[frames.length - 1] > 1 ? `${(-times[frames.length - 1]).toFixed(1)} s old` : `${last.q[joint].toFixed(3)} ${this.unit}${Number.isFinite(off) ? `, command ${off >= 0 ? "+" : "−"}${Math.abs(off).toFixed(3)}` : ""}`);
    }
    this.drawn += 1;
  }
}
