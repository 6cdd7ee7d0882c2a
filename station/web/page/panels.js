// The lists: alarms, servers, keys, events. Whole lists come, are cut, and replace what was there.
import { brief, byId, dress, el, keep, list, number, show, write } from "./dom.js";
import { OLD_S, age, rate, thousands } from "./figures.js";

const MOST_ALARMS = 8, MOST_SERVERS = 60, MOST_KEYS = 500, MOST_EVENTS = 500;

/** Cells of a row, made once. @param {number} count @param {string} [first] */
function row(count, first = "th") {
  const line = el("tr");
  for (let i = 0; i < count; i += 1) {
    const cell = el(i === 0 ? first : "td");
    if (i === 0 && first === "th") cell.scope = "row";
    line.append(cell);
  }
  return line;
}

/** @param {import("./link.js").Link} link */
export function showAlarms(link) {
  const box = byId("alarms");
  const render = () => {
    const alarms = list(link.state?.alarms, MOST_ALARMS);
    keep(box, alarms, (alarm) => `${brief(alarm.level, 10)} ${brief(alarm.text).replace(/[\d.]+/g, "#")}`, () => {
      const line = el("p");
      line.append(el("b"), el("span"), el("small"));
      line.children[2].setAttribute("aria-live", "off");
      return line;
    }, (line, alarm) => {
      dress(line, alarm.level === "error" ? "alarm error" : "alarm warning");
      write(line.children[0], alarm.level === "error" ? "Error" : "Warning");
      write(line.children[1], alarm.text);
      write(line.children[2], Number.isNaN(link.ageNow(alarm.since_s)) ? "" : `for ${age(link.ageNow(alarm.since_s))}`);
    });
    show(box, alarms.length > 0);
  };
  link.addEventListener("state", render);
}

/** @param {import("./link.js").Link} link */
export function showServers(link) {
  const rows = byId("server-rows"), count = byId("servers-count");
  const render = () => {
    const servers = list(link.state?.servers, MOST_SERVERS);
    keep(rows, servers, (server) => brief(server.name, 120), () => row(5), (line, server) => {
      const now = link.ageNow(server.age_s), [name, state, hz, jitter, old] = line.children;
      dress(line, server.is_alive === false ? "dead" : now > OLD_S * 3 ? "old" : "");
      write(name, brief(server.name, 60));
      name.title = brief(server.role, 60);
      write(state, server.is_alive === false ? brief(server.reason, 120) || "silent" : brief(server.state, 30));
      state.title = brief(server.reason);
      write(hz, rate(server.rate_hz));
      write(jitter, Number.isNaN(number(server.jitter_p99_ms)) ? "" : `${number(server.jitter_p99_ms).toFixed(1)} ms`);
      write(old, age(now));
      dress(hz, "n"); dress(jitter, "n"); dress(old, "n");
    });
    const dead = servers.filter((server) => server.is_alive === false).length;
    write(count, servers.length ? `${servers.length - dead} of ${servers.length} alive` : "none");
  };
  link.addEventListener("state", render);
  link.addEventListener("beat", () => { if (!link.is_up) render(); });
}

/** @param {import("./link.js").Link} link */
export function showKeys(link) {
  const rows = byId("key-rows"), count = byId("keys-count"), filter = byId("keys-filter");
  /** @type {any[]} */
  let keys = [];
  let came = 0;
  const render = () => {
    const wanted = filter.value.trim().toLowerCase();
    const since = (performance.now() - came) / 1000;
    const shown = keys.filter((key) => !wanted || `${brief(key.key, 200)} ${brief(key.writer, 80)} ${brief(key.role, 40)}`.toLowerCase().includes(wanted));
    keep(rows, shown, (key) => `${brief(key.key, 200)}`, () => row(4), (line, key) => {
      const now = number(key.age_s) + since, [name, writer, hz, old] = line.children;
      dress(line, now > OLD_S ? "old" : "");
      write(name, brief(key.key, 120));
      name.title = brief(key.key);
      write(writer, brief(key.writer, 40));
      write(hz, rate(key.rate_hz));
      write(old, age(now));
      dress(hz, "n"); dress(old, "n");
    });
    write(count, wanted ? `${shown.length} of ${keys.length}` : keys.length === MOST_KEYS ? `first ${MOST_KEYS}` : String(keys.length));
  };
  link.on("keys", (message) => { keys = list(message.keys, MOST_KEYS); came = performance.now(); render(); });
  filter.addEventListener("input", render);
  link.addEventListener("beat", () => { if (!link.is_up) render(); });
}

/** @param {import("./link.js").Link} link */
export function showEvents(link) {
  const box = byId("event-list"), count = byId("events-count");
  let total = 0;
  link.addEventListener("link", () => {
    if (!link.is_up) return;  // the last 50 come again
    box.replaceChildren();
    total = 0;
  });
  /** @type {any[]} */
  let waiting = [];
  const flush = () => {
    const lines = waiting.slice(-MOST_EVENTS);
    waiting = [];
    for (const event of lines) {
      const line = el("li", ["warning", "error"].includes(event.severity) ? event.severity : "info");
      const at = new Date(Date.now() - number(event.age_s, 0) * 1000);
      const words = el("span", "", brief(event.text || event.name));
      words.title = words.textContent;
      line.append(el("time", "", at.toTimeString().slice(0, 8)), el("b", "", brief(event.source, 40)), words);
      line.title = brief(event.name, 80);
      box.prepend(line);
    }
    while (box.childElementCount > MOST_EVENTS) box.lastElementChild.remove();
    write(count, total > MOST_EVENTS ? `newest ${MOST_EVENTS} of ${thousands(total)}` : String(total));
  };
  link.on("event", (message) => {
    total += 1;
    // A flood of events costs one drawing of the newest, not one each.
    if (waiting.push(message) === 1) setTimeout(flush, 100);
    if (waiting.length > 2 * MOST_EVENTS) waiting.splice(0, MOST_EVENTS - 1);
  });
}
