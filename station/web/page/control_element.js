// What the orbit controls take for an element of a page: a worker has none, and gets the events as messages.

export class ControlElement extends EventTarget {
  constructor() {
    super();
    this.style = {};
    this.clientWidth = 1;
    this.clientHeight = 1;
    /** The controls listen on the document while a pointer is down; here that is the same thing. */
    this.ownerDocument = this;
  }

  /** @param {number} width @param {number} height */
  resize(width, height) { this.clientWidth = width; this.clientHeight = height; }
  getRootNode() { return this; }
  setPointerCapture() { /* the page did */ }
  releasePointerCapture() { /* the page does */ }
  getBoundingClientRect() { return { left: 0, top: 0, right: this.clientWidth, bottom: this.clientHeight, width: this.clientWidth, height: this.clientHeight, x: 0, y: 0 }; }

  /** @param {any} plain */
  dispatch(plain) {
    const event = new Event(plain.type, { cancelable: true });
    for (const [name, value] of Object.entries(plain)) if (name !== "type") Object.defineProperty(event, name, { value });
    this.dispatchEvent(event);
  }
}
