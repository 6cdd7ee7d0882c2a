// The newest picture for each eye; where there is one camera, both eyes see it.
import { pictureSize } from "/page/picture_size.js";
import { Feeds } from "/page/feeds.js";

const MOST_BYTES = 8e6, MOST_PIXELS = 4096 * 4096;
export const FROZEN_MS = 500;

export class Pictures {
  /** @param {string[]} eyes names of the feeds */
  constructor(eyes) {
    /** @type {Map<string, {bitmap: ImageBitmap, at: number, number: number}>} */
    this.newest = new Map();
    this.shown = 0;
    if (eyes.length) {
      this.feeds = new Feeds();
      for (const eye of eyes.slice(0, 2)) this.feeds.want(eye, (header, data, offset) => this.take(eye, header, new Uint8Array(data, offset)));
    }
  }

  /** @param {string} eye "left" or "right" */
  of(eye) { return this.newest.get(`eye:${eye}`) ?? this.newest.get("eye:left"); }

  /** @param {string} eye @param {any} header @param {Uint8Array<ArrayBuffer>} bytes */
  async take(eye, header, bytes) {
    const size = bytes.length <= MOST_BYTES ? pictureSize(bytes) : null;
    if (!size || size[0] < 1 || size[1] < 1 || size[0] * size[1] > MOST_PIXELS) return;
    const age_ms = Number(header.age_ms) || 0, came = performance.now();
    const bitmap = await createImageBitmap(new Blob([bytes], { type: "image/jpeg" }));
    this.newest.get(eye)?.bitmap.close();
    this.shown += 1;
    this.newest.set(eye, { bitmap, at: came - age_ms, number: this.shown });
  }
}
