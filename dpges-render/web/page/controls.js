// Mouse, touch, wheel and keys on the canvas, as movements of an OrbitCamera.

// Radians per height of the canvas.
const TURN = 4;
// Natural logarithm of the ratio of distances per px of the wheel.
const WHEEL = 0.0015;
// px of a line of a wheel that scrolls by lines.
const LINE_PX = 18;
// Movement of keys per second: radians, and distances to the target.
const KEY_TURN = 1.4;
const KEY_FLY = 0.7;
const KEY_ZOOM = 1.5;
const FASTER = 4;
// A pointer that has rested for so long before it is lifted does not throw the scene, ms.
const REST_MS = 60;

// Held keys and what they do each second: [turn yaw, turn pitch, shift right, shift down, shift forward, zoom].
const HELD = {
  ArrowLeft: [1, 0, 0, 0, 0, 0], ArrowRight: [-1, 0, 0, 0, 0, 0], ArrowUp: [0, 1, 0, 0, 0, 0], ArrowDown: [0, -1, 0, 0, 0, 0],
  KeyA: [0, 0, -1, 0, 0, 0], KeyD: [0, 0, 1, 0, 0, 0], KeyE: [0, 0, 0, -1, 0, 0], KeyQ: [0, 0, 0, 1, 0, 0],
  KeyW: [0, 0, 0, 0, 1, 0], KeyS: [0, 0, 0, 0, -1, 0],
  Equal: [0, 0, 0, 0, 0, -1], NumpadAdd: [0, 0, 0, 0, 0, -1], Minus: [0, 0, 0, 0, 0, 1], NumpadSubtract: [0, 0, 0, 0, 0, 1],
};

// Whether a key is meant for the scene: not for a button, a setting or the browser.
export function isForScene(event) {
  const free = event.target === document.body || event.target instanceof HTMLCanvasElement;
  return free && !event.ctrlKey && !event.metaKey && !event.altKey;
}

export class Controls {
  pointers = new Map();
  held = new Set();
  faster = false;

  // Calls `changed` whenever the camera has moved or is about to.
  constructor(canvas, camera, changed) {
    Object.assign(this, { canvas, camera, changed });
    this.calm = matchMedia("(prefers-reduced-motion: reduce)");
    const on = (type, handle, options) => canvas.addEventListener(type, handle.bind(this), options);
    on("pointerdown", this.press);
    on("pointermove", this.move);
    on("pointerup", this.release);
    on("pointercancel", this.release);
    on("wheel", this.wheel, { passive: false });
    on("contextmenu", (event) => event.preventDefault());
    document.addEventListener("keydown", (event) => this.keyDown(event));
    document.addEventListener("keyup", (event) => this.keyUp(event));
    addEventListener("blur", () => this.held.clear());
  }

  press(event) {
    this.canvas.focus({ preventScroll: true });
    this.canvas.setPointerCapture(event.pointerId);
    const shifts = event.button !== 0 || event.shiftKey || event.ctrlKey;
    this.pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, shifts });
    this.camera.stop();
    this.last = event.timeStamp;
  }

  move(event) {
    const pointer = this.pointers.get(event.pointerId);
    if (!pointer) return;
    const before = this.grip();
    [pointer.x, pointer.y] = [event.clientX, event.clientY];
    const after = this.grip();
    const seconds = Math.max(event.timeStamp - this.last, 1) / 1000;
    this.last = event.timeStamp;
    const height = this.canvas.clientHeight;
    const [dx, dy] = [(after.x - before.x) / height, (after.y - before.y) / height];
    const speed = { yaw: 0, pitch: 0, right: 0, down: 0, zoom: 0 };
    if (this.pointers.size > 1 || pointer.shifts) {
      // A point at the target's depth stays below the fingers.
      const heights = this.canvas.clientHeight / this.camera.focal(this.canvas.clientWidth, this.canvas.clientHeight);
      Object.assign(speed, { right: -dx * heights, down: -dy * heights });
    } else {
      Object.assign(speed, { yaw: -dx * TURN, pitch: -dy * TURN });
    }
    if (before.spread > 0 && after.spread > 0) speed.zoom = Math.log(before.spread / after.spread);
    this.camera.turn(speed.yaw, speed.pitch);
    this.camera.shift(speed.right, speed.down);
    this.camera.zoom(speed.zoom);
    // A mean over the last few events: single ones are uneven.
    for (const key of Object.keys(speed)) this.camera.speed[key] = 0.5 * (this.camera.speed[key] + speed[key] / seconds);
    this.changed();
  }

  release(event) {
    if (!this.pointers.delete(event.pointerId)) return;
    if (this.pointers.size > 0 || this.calm.matches || event.timeStamp - this.last > REST_MS) this.camera.stop();
    this.changed();
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
    const px = event.deltaY * (event.deltaMode === WheelEvent.DOM_DELTA_LINE ? LINE_PX : 1);
    // Browsers report a pinch on a touchpad as a wheel with Ctrl and small steps.
    this.camera.zoom(px * WHEEL * (event.ctrlKey ? 6 : 1));
    this.changed();
  }

  keyDown(event) {
    this.faster = event.shiftKey;
    if (!(event.code in HELD) || !isForScene(event)) return;
    event.preventDefault();
    this.held.add(event.code);
    this.changed();
  }

  keyUp(event) {
    this.faster = event.shiftKey;
    this.held.delete(event.code);
  }

  // Moves the camera by what goes on without events; `false` if nothing does.
  advance(seconds) {
    for (const code of this.held) {
      const [yaw, pitch, right, down, forward, zoom] = HELD[code].map((part) => part * seconds);
      const fly = KEY_FLY * (this.faster ? FASTER : 1);
      this.camera.turn(yaw * KEY_TURN, pitch * KEY_TURN);
      this.camera.shift(right * fly, down * fly, forward * fly);
      this.camera.zoom(zoom * KEY_ZOOM);
    }
    const gliding = this.pointers.size === 0 && this.camera.glide(seconds);
    return this.held.size > 0 || gliding;
  }
}
