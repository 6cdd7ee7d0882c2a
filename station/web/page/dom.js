// What every panel needs of the DOM. Values of the bus reach the page through `textContent` alone, and shortened: a key
// with markup in its name is a key with an odd name, and one of 64 MiB is cut before anything measures it.

/** @param {string} id @returns {any} */
export const byId = (id) => document.getElementById(id);

export const LONGEST_TEXT = 240;

/**
 * Any value of the bus as a short line of text; control characters, and those that turn the direction of writing, become
 * spaces.
 * @param {unknown} value @param {number} [most] characters
 */
export function brief(value, most = LONGEST_TEXT) {
  if (value === null || value === undefined) return "";
  const text = typeof value === "object" ? "(not a text)" : String(value);
  const cut = text.length > most ? `${text.slice(0, most - 1)}…` : text;
  // eslint-disable-next-line no-control-regex
  return cut.replace(/[\u0000-\u001f\u007f-\u009f\u200b-\u200f\u2028-\u202e\u2066-\u2069\ufeff]/g, " ");
}

/** @param {unknown} value @param {number} [otherwise] */
export const number = (value, otherwise = NaN) => (typeof value === "number" && Number.isFinite(value) ? value : otherwise);

/**
 * @param {unknown} value @param {number} most
 * @returns {any[]} at most so many, and only objects
 */
export const list = (value, most) =>
  Array.isArray(value) ? value.slice(0, most).filter((item) => item !== null && typeof item === "object") : [];

/**
 * @param {string} tag @param {string} [kind] classes @param {unknown} [text] @param {(Node|null)[]} children
 * @returns {any}
 */
export function el(tag, kind = "", text = undefined, ...children) {
  const node = document.createElement(tag);
  if (kind) node.className = kind;
  if (text !== undefined) node.textContent = brief(text);
  for (const child of children) if (child) node.append(child);
  return node;
}

/** Writes only what changed, so that nothing is laid out or read aloud twice. @param {any} node @param {unknown} text */
export function write(node, text) {
  const short = brief(text);
  if (node.textContent !== short) node.textContent = short;
}

/** @param {any} node @param {string} kind */
export function dress(node, kind) {
  if (node.className !== kind) node.className = kind;
}

/** @param {any} node @param {boolean} is_shown */
export function show(node, is_shown) {
  if (node.hidden === is_shown) node.hidden = !is_shown;
}

/**
 * Keeps one child for each item, in order, without making those anew that are there: focus and a held button survive.
 * @template T
 * @param {any} parent @param {T[]} items @param {(item: T) => string} name
 * @param {(item: T) => any} make @param {(node: any, item: T) => void} fill
 */
export function keep(parent, items, name, make, fill) {
  const old = parent.kept ?? (parent.kept = new Map());
  const now = new Map();
  let place = parent.firstElementChild;
  for (const item of items) {
    const key = name(item);
    if (now.has(key)) continue;
    const node = old.get(key) ?? make(item);
    now.set(key, node);
    old.delete(key);
    if (node === place) place = place.nextElementSibling;
    else parent.insertBefore(node, place);
    fill(node, item);
  }
  for (const node of old.values()) node.remove();
  parent.kept = now;
}
