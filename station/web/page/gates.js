// The states of a robot's gate: which of them count as stopped, and the colours that our reports give them.

/** Left by a release alone. */
export const LATCHED = new Set(["stopped", "faulted"]);

/** The bands of a report's lane of the gate; the same on both themes. @type {Record<string, string>} */
export const COLOURS = {
  tracking: "#cfe9d5", entering: "#c6def5", waiting: "#e0e4e8", holding: "#ffdfae", returning: "#e4c9ec",
  stopped: "#f3b3b0", faulted: "#f3b3b0",
};

/** @param {string} gate @returns {string} a class of the style sheet */
export const kind = (gate) => (Object.hasOwn(COLOURS, gate) ? `gate ${gate}` : "gate unknown");
