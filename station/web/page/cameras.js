// The newest picture of each camera, with its age and rate. A picture that stands still says so: an operator who drives
// by a frozen one is worse off than without.
import { brief, byId, dress, el, keep, list, number, show, write } from "./dom.js";
import { age, moment, rate } from "./figures.js";
import { pictureSize } from "./picture_size.js";

const FROZEN_S = 0.5, MOST = 8, MOST_BYTES = 8e6, MOST_PIXELS = 4096 * 4096;

export class Cameras {
  /** @param {import("./link.js").Link} link @param {import("./feeds.js").Feeds} feeds */
  constructor(link, feeds) {
    this.link = link;
    this.feeds = feeds;
    this.box = byId("camera-list");
    /** What an episode shows in place of the live cameras. @type {import("./playback.js").Playback | null} */
    this.recorded = null;
    link.addEventListener("state", () => this.show());
    setInterval(() => this.ages(), 100);
  }

  /** @param {import("./playback.js").Playback | null} playback */
  setRecorded(playback) {
    this.recorded = playback;
    this.show();
  }

  show() {
    const { recorded } = this, all = recorded ? recorded.cameras.map((name) => ({ name })) : list(this.link.state?.cameras, MOST);
    const cameras = all.filter((camera) => typeof camera.name === "string" && camera.name.length < 200)
      .map((camera) => ({ ...camera, feed: `${recorded ? "play:" : ""}camera:${camera.name}` }));
    const feeds = new Set(cameras.map((camera) => camera.feed));
    for (const feed of [...this.feeds.wanted.keys()]) if (/^(play:)?camera:/.test(feed) && !feeds.has(feed)) this.feeds.leave(feed);
    keep(this.box, cameras, (camera) => camera.feed, (camera) => this.make(camera), (figure, camera) => {
      figure.state = camera;
      const width = number(camera.width), height = number(camera.height);
      if (!figure.is_sized && width > 0 && height > 0 && width / height < 5 && height / width < 5) figure.canvas.style.aspectRatio = `${width} / ${height}`;
    });
    show(byId("cameras"), cameras.length > 0);
    this.box.dataset.count = String(cameras.length);
  }

  /** @param {any} camera */
  make(camera) {
    const figure = el("figure"), canvas = document.createElement("canvas");
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${this.recorded ? "Recorded" : "Newest"} picture of camera ${brief(camera.name, 60)}`);
    canvas.width = 640; canvas.height = 480;
    const context = canvas.getContext("bitmaprenderer");
    figure.canvas = canvas;
    figure.drawn_at = -Infinity;
    figure.frame_age_s = NaN;
    figure.caption = el("figcaption", "", undefined, el("b", "", brief(camera.name, 60)), el("span"), el("span", "n"));
    figure.frozen = el("p", "frozen");
    figure.frozen.hidden = true;
    figure.append(canvas, figure.frozen, figure.caption);
    const { recorded } = this;
    this.feeds.want(camera.feed, async (header, data, offset) => {
      if (recorded && !recorded.isOurs(header)) return;
      const bytes = new Uint8Array(data, offset);
      const size = bytes.length <= MOST_BYTES ? pictureSize(bytes) : null;
      if (!size || size[0] < 1 || size[1] < 1 || size[0] * size[1] > MOST_PIXELS) { figure.wrong = "not a picture that can be shown"; return; }
      const came = performance.now();
      let bitmap;
      try { bitmap = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" })); } catch { figure.wrong = "a broken picture"; return; }
      figure.wrong = "";
      if (canvas.width !== bitmap.width || canvas.height !== bitmap.height || !figure.is_sized) {
        canvas.width = bitmap.width; canvas.height = bitmap.height;
        figure.is_sized = true;
        canvas.style.aspectRatio = `${bitmap.width} / ${bitmap.height}`;
      }
      context?.transferFromImageBitmap(bitmap);
      figure.drawn_at = came;
      figure.frame_age_s = number(header.age_ms, NaN) / 1000;
      figure.rate_hz = header.rate_hz;
      figure.taken_s = number(header.taken_s);
    });
    return figure;
  }

  /** Ages are of the picture on the screen: its own when it came, and the time since. */
  ages() {
    const now = performance.now();
    for (const figure of this.box.children) {
      if (this.recorded) { this.moment(figure, this.recorded); continue; }
      const old_s = number(figure.frame_age_s) + (now - figure.drawn_at) / 1000;
      const is_frozen = !(old_s <= FROZEN_S);
      write(figure.caption.children[1], rate(figure.rate_hz ?? figure.state?.rate_hz));
      write(figure.caption.children[2], Number.isNaN(old_s) ? "no picture" : age(old_s));
      show(figure.frozen, is_frozen);
      if (is_frozen) write(figure.frozen, figure.wrong ? `FROZEN: ${figure.wrong}` : Number.isNaN(old_s) ? "NO PICTURE yet" : `FROZEN for ${age(old_s)}`);
      dress(figure, is_frozen ? "frozen-picture" : "");
    }
  }

  /** What is said of a recorded picture: when it came. @param {any} figure @param {import("./playback.js").Playback} recorded */
  moment(figure, recorded) {
    const newest_s = number(Object.hasOwn(recorded.pictures, figure.state.name) ? recorded.pictures[figure.state.name] : NaN), old_s = recorded.time_s - newest_s;
    const is_frozen = !(old_s <= FROZEN_S);
    write(figure.caption.children[1], "recorded");
    write(figure.caption.children[2], Number.isNaN(newest_s) ? "no picture" : `at ${moment(number(figure.taken_s, newest_s))}`);
    show(figure.frozen, is_frozen || Boolean(figure.wrong));
    write(figure.frozen, figure.wrong ? String(figure.wrong) : Number.isNaN(newest_s) ? "NO PICTURE yet" : `FROZEN for ${age(old_s)}`);
    dress(figure, is_frozen ? "frozen-picture" : "");
  }
}
