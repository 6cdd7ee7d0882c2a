// Episodes that were recorded, and a panel with what is known of one. The panel is no modal dialog: nothing on this page
// may lie over the stop or take the keyboard from it.
import { brief, byId, dress, el, keep, list, show, write } from "./dom.js";
import { clock, when } from "./figures.js";

const MOST = 200, VERDICTS = new Set(["good", "usable", "reject", "discarded", "open"]);

/** @param {unknown} verdict */
const badge = (verdict) => `badge ${VERDICTS.has(String(verdict)) ? verdict : ""}`.trim();

export class Episodes {
  /** @param {import("./link.js").Link} link @param {(id: string, opener: any) => void} play */
  constructor(link, play) {
    this.play = play;
    this.panel = byId("episode");
    /** @type {any} */
    this.opener = null;
    this.opened = "";
    link.on("episodes", (message) => this.show(list(message.episodes, MOST)));
    byId("episode-close").addEventListener("click", () => this.close());
    this.panel.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => { if (event.key === "Escape") this.close(); });
  }

  /** @param {any[]} episodes */
  show(episodes) {
    write(byId("episodes-count"), episodes.length === MOST ? `newest ${MOST}` : String(episodes.length));
    keep(byId("episode-list"), episodes, (episode) => brief(episode.id, 200), (episode) => {
      const button = el("button", "row");
      button.type = "button";
      button.append(el("span", "badge"), el("b"), el("small"), el("span", "soft"));
      button.addEventListener("click", () => void this.openEpisode(String(episode.id), button));
      return el("li", "", undefined, button);
    }, (item, episode) => {
      const [verdict, task, figures, reason] = item.firstElementChild.children;
      dress(verdict, badge(episode.verdict));
      write(verdict, brief(episode.verdict || episode.state, 16) || "unchecked");
      write(task, brief(episode.task, 60) || brief(episode.id, 60));
      const some = (/** @type {unknown} */ count, /** @type {string} */ one) => (Number(count) > 0 ? `${Number(count)} ${one}${Number(count) > 1 ? "s" : ""}` : "");
      const kept = episode.success === true ? "success" : episode.success === false ? "failure" : "";
      write(figures, [Number.isFinite(episode.duration_s) ? clock(episode.duration_s) : "", kept, some(episode.marks, "mark"), some(episode.falls, "fall"), when(episode.started)].filter(Boolean).join(" · "));
      write(reason, brief(episode.reason, 120));
    });
  }

  /** @param {string} id @param {any} opener */
  async openEpisode(id, opener) {
    this.opener = opener;
    this.opened = id;
    const body = byId("episode-body");
    write(byId("episode-title"), id);
    body.replaceChildren(el("p", "soft", "Reading it…"));
    show(this.panel, true);
    byId("episode-title").focus();
    let detail;
    try {
      const answer = await fetch(`/api/episode?id=${encodeURIComponent(id)}`, { signal: AbortSignal.timeout?.(30000) });
      detail = await answer.json();
      if (!answer.ok) throw new Error(detail?.error ?? `the station answered ${answer.status}`);
    } catch (error) {
      if (this.opened === id) body.replaceChildren(el("p", "bad", `Not read: ${error instanceof Error ? error.message : error}`));
      return;
    }
    if (this.opened !== id) return;
    const reasons = el("ul", "reasons");
    for (const reason of (Array.isArray(detail.reasons) ? detail.reasons : []).slice(0, 30)) reasons.append(el("li", VERDICTS.has(detail.verdict) ? detail.verdict : "", reason));
    const figures = el("dl", "facts");
    for (const pair of (Array.isArray(detail.figures) ? detail.figures : []).slice(0, 60)) {
      if (Array.isArray(pair)) figures.append(el("div", "", undefined, el("dt", "", pair[0]), el("dd", "", pair[1])));
    }
    const manifest = el("pre");
    manifest.textContent = String(detail.manifest_text ?? "").slice(0, 20000);
    manifest.tabIndex = 0;
    body.replaceChildren(
      el("p", "line", undefined, el("span", badge(detail.verdict), brief(detail.verdict, 16) || "unchecked"), el("b", "", brief(detail.task, 120))),
      el("div", "buttons", undefined, this.playButton(id)), reasons, figures);
    if (detail.has_sheet) this.sheet(body, id);
    body.append(el("details", "", undefined, el("summary", "", "Manifest"), manifest));
  }

  /** @param {string} id */
  playButton(id) {
    const button = el("button", "primary", "Play");
    button.type = "button";
    button.id = "episode-play";
    button.addEventListener("click", () => {
      const { opener } = this;
      this.close();
      this.play(id, opener);
    });
    return button;
  }

  /** @param {any} body @param {string} id */
  sheet(body, id) {
    const wait = el("p", "soft", "The contact sheet is being drawn…");
    const picture = document.createElement("img");
    picture.alt = `Contact sheet of ${brief(id, 80)}`;
    picture.onload = () => wait.remove();
    picture.onerror = () => { picture.remove(); write(wait, "There is no contact sheet of it."); };
    picture.src = `/api/episode/sheet?id=${encodeURIComponent(id)}`;
    body.append(wait, picture);
  }

  close() {
    show(this.panel, false);
    this.opened = "";
    byId("episode-body").replaceChildren();
    this.opener?.focus();
  }
}
