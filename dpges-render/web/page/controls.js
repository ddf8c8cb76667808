// Mouse, touch, wheel and keys on the canvas, told to the viewer, which moves as the window does.

// px of a notch of a wheel, and its lines where it scrolls by lines.
const NOTCH_PX = 100;
const NOTCH_LINES = 3;
// Natural logarithm of the ratio of distances per px of a pinch on a touchpad.
const PINCH = 0.009;

// Held keys: walking right, down, forward; turning right, down; nearer.
const HELD = {
  KeyD: [1, 0, 0, 0, 0, 0], KeyA: [-1, 0, 0, 0, 0, 0], KeyQ: [0, 1, 0, 0, 0, 0], KeyE: [0, -1, 0, 0, 0, 0],
  KeyW: [0, 0, 1, 0, 0, 0], KeyS: [0, 0, -1, 0, 0, 0],
  ArrowRight: [0, 0, 0, 1, 0, 0], ArrowLeft: [0, 0, 0, -1, 0, 0], ArrowDown: [0, 0, 0, 0, 1, 0], ArrowUp: [0, 0, 0, 0, -1, 0],
  Equal: [0, 0, 0, 0, 0, 1], NumpadAdd: [0, 0, 0, 0, 0, 1], Minus: [0, 0, 0, 0, 0, -1], NumpadSubtract: [0, 0, 0, 0, 0, -1],
};

// Whether a key is meant for the scene: not for a button, a setting or the browser.
export function isForScene(event) {
  const free = event.target === document.body || event.target instanceof HTMLCanvasElement;
  return free && !event.ctrlKey && !event.metaKey && !event.altKey;
}

// Whether the visitor wants nothing to move by itself.
export const calm = matchMedia("(prefers-reduced-motion: reduce)");

export class Controls {
  pointers = new Map();
  held = new Set();
  faster = false;

  // Tells `viewer()`, which is null while no scene is shown, and calls `changed` after that.
  constructor(canvas, viewer, changed) {
    Object.assign(this, { canvas, changed });
    this.tell = (change) => {
      if (viewer()) change(viewer());
      changed();
    };
    const on = (type, handle, options) => canvas.addEventListener(type, handle.bind(this), options);
    on("pointerdown", this.press);
    on("pointermove", this.move);
    on("pointerup", this.release);
    on("pointercancel", this.release);
    on("wheel", this.wheel, { passive: false });
    on("dblclick", this.focus);
    on("contextmenu", (event) => event.preventDefault());
    document.addEventListener("keydown", (event) => this.key(event, true));
    document.addEventListener("keyup", (event) => this.key(event, false));
    addEventListener("blur", () => {
      this.held.clear();
      this.hold();
    });
  }

  press(event) {
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    const what = event.button !== 0 || event.shiftKey ? "pan" : event.ctrlKey || event.metaKey ? "look" : "orbit";
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, what });
    this.tell((viewer) => {
      viewer.stop();
      viewer.hold(true);
    });
  }

  move(event) {
    const pointer = this.pointers.get(event.pointerId);
    if (!pointer) return;
    const before = this.grip();
    [pointer.x, pointer.y] = [event.clientX, event.clientY];
    const after = this.grip();
    const height = this.canvas.clientHeight;
    this.tell((viewer) => {
      viewer.drag(this.pointers.size > 1 ? "pan" : pointer.what, (after.x - before.x) / height, (after.y - before.y) / height);
      if (before.spread > 0 && after.spread > 0) viewer.pinch(after.spread / before.spread);
    });
  }

  release(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    this.tell((viewer) => {
      viewer.hold(this.pointers.size > 0);
      if (this.pointers.size > 0 || calm.matches) viewer.stop();
    });
  }

  // Middle of the pointers that are down, and how far apart the first two are.
  grip() {
    const all = [...this.pointers.values()];
    const mean = (key) => all.reduce((sum, pointer) => sum + pointer[key], 0) / all.length;
    const spread = all.length > 1 ? Math.hypot(all[0].x - all[1].x, all[0].y - all[1].y) : 0;
    return { x: mean("x"), y: mean("y"), spread };
  }

  wheel(event) {
    event.preventDefault();
    const notch = event.deltaMode === WheelEvent.DOM_DELTA_LINE ? NOTCH_LINES : NOTCH_PX;
    // Browsers report a pinch on a touchpad as a wheel with Ctrl and small steps.
    this.tell((viewer) => (event.ctrlKey ? viewer.pinch(Math.exp(-PINCH * event.deltaY)) : viewer.wheel(-event.deltaY / notch)));
  }

  focus(event) {
    const { left, top, width, height } = this.canvas.getBoundingClientRect();
    this.tell((viewer) => viewer.focus_at((event.clientX - left) / width, (event.clientY - top) / height));
  }

  key(event, down) {
    const shift = this.faster !== event.shiftKey;
    this.faster = event.shiftKey;
    const meant = event.code in HELD && (!down || isForScene(event));
    if (meant && down) {
      event.preventDefault();
      this.held.add(event.code);
    } else if (meant) {
      this.held.delete(event.code);
    }
    if (meant || (shift && this.held.size > 0)) this.hold();
  }

  hold() {
    const axes = [0, 1, 2, 3, 4, 5].map((axis) => [...this.held].reduce((sum, code) => sum + HELD[code][axis], 0));
    this.tell((viewer) => viewer.keys(axes, this.faster));
  }
}
