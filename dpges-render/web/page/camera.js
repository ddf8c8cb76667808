// A camera that turns around a point, with the world's up upwards in the picture. World units and radians.

const STEEPEST = 89.5 * Math.PI / 180;
// Time in which a movement let go slows to 1/e, seconds.
const GLIDE_S = 0.16;
// Movements slower than this per second, in the units of each, have ended.
const STILL = 1e-3;

export const add = (a, b, factor = 1) => a.map((value, i) => value + factor * b[i]);
export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
export const length = (a) => Math.hypot(...a);
export const scale = (a, factor) => a.map((value) => value * factor);
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => scale(a, 1 / length(a));
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

export class OrbitCamera {
  target = [0, 0, 0];
  distance = 1;
  yaw = 0;
  pitch = 0;
  // Tangents of half the horizontal and vertical field of view that are at least in the picture.
  field = [Math.tan(25 * Math.PI / 180), Math.tan(25 * Math.PI / 180)];
  speed = { yaw: 0, pitch: 0, right: 0, down: 0, zoom: 0 };

  constructor(up = [0, 0, 1]) {
    this.setUp(up);
  }

  // Keeps the target, the distance and the angles.
  setUp(up) {
    this.up = unit(up);
    const least = this.up.map(Math.abs).reduce((at, value, i, all) => (value < all[at] ? i : at), 0);
    const axis = [0, 1, 2].map((i) => (i === least ? 1 : 0));
    this.ahead = unit(add(axis, this.up, -dot(axis, this.up)));
    this.left = cross(this.up, this.ahead);
  }

  // Axes of the picture in the world: right, down, forward.
  axes() {
    const level = add(scale(this.ahead, Math.cos(this.yaw)), this.left, Math.sin(this.yaw));
    const forward = add(scale(level, Math.cos(this.pitch)), this.up, Math.sin(this.pitch));
    const right = cross(level, this.up);
    return { right, down: cross(forward, right), forward };
  }

  eye() {
    return add(this.target, this.axes().forward, -this.distance);
  }

  lookAlong(forward) {
    const direction = unit(forward);
    this.yaw = Math.atan2(dot(direction, this.left), dot(direction, this.ahead));
    this.pitch = clamp(Math.asin(clamp(dot(direction, this.up), -1, 1)), -STEEPEST, STEEPEST);
  }

  // Sees all of a sphere from obliquely above.
  fit(centre, radius) {
    this.target = centre;
    this.distance = radius / Math.sin(Math.atan(Math.min(...this.field)));
    this.yaw = 0.6;
    this.pitch = -0.35;
  }

  // Stands where `entry` of cameras.json stands and turns around what it sees at the depth of `centre`; roll is lost.
  place(entry, centre, radius) {
    const forward = entry.rotation.map((row) => row[2]);
    this.field = [entry.width / (2 * entry.fx), entry.height / (2 * entry.fy)];
    this.distance = Math.max(dot(add(centre, entry.position, -1), forward), 0.2 * radius);
    this.lookAlong(forward);
    this.target = add(entry.position, this.axes().forward, this.distance);
  }

  turn(yaw, pitch) {
    this.yaw += yaw;
    this.pitch = clamp(this.pitch + pitch, -STEEPEST, STEEPEST);
  }

  // Distances in units of the distance to the target.
  shift(right, down, forward = 0) {
    const axes = this.axes();
    for (const [axis, part] of [[axes.right, right], [axes.down, down], [axes.forward, forward]]) {
      this.target = add(this.target, axis, part * this.distance);
    }
  }

  // Farther for a positive natural logarithm of the ratio of distances.
  zoom(logarithm) {
    this.distance = clamp(this.distance * Math.exp(logarithm), 1e-6, 1e9);
  }

  stop() {
    for (const key of Object.keys(this.speed)) this.speed[key] = 0;
  }

  // Lets a movement that was let go glide on; `false` once it has ended.
  glide(seconds) {
    if (!this.gliding()) return false;
    const { yaw, pitch, right, down, zoom } = this.speed;
    const share = GLIDE_S * (1 - Math.exp(-seconds / GLIDE_S));
    this.turn(yaw * share, pitch * share);
    this.shift(right * share, down * share);
    this.zoom(zoom * share);
    for (const key of Object.keys(this.speed)) this.speed[key] *= Math.exp(-seconds / GLIDE_S);
    if (!this.gliding()) this.stop();
    return true;
  }

  gliding() {
    return Object.values(this.speed).some((speed) => Math.abs(speed) > STILL);
  }

  // Focal length in px at which the whole field is in a picture of that size.
  focal(width, height) {
    return Math.min(width / (2 * this.field[0]), height / (2 * this.field[1]));
  }

  // Vertical field of view, degrees.
  get fieldDegrees() {
    return 2 * Math.atan(this.field[1]) * 180 / Math.PI;
  }

  set fieldDegrees(degrees) {
    const tangent = Math.tan(degrees * Math.PI / 360);
    this.field = [this.field[0] * tangent / this.field[1], tangent];
  }

  // In the convention of cameras.json: position, rotation from camera to world by rows, focal lengths and size in px.
  entry(width, height) {
    const { right, down, forward } = this.axes();
    const focal = this.focal(width, height);
    const rotation = [0, 1, 2].map((i) => [right[i], down[i], forward[i]]);
    return { position: this.eye(), rotation, fx: focal, fy: focal, width, height };
  }
}

// The cameras of a cameras.json, or an error that names what is wrong.
export function parseCameras(text) {
  const cameras = JSON.parse(text);
  const numbers = (value, count) => Array.isArray(value) && value.length === count && value.every(Number.isFinite);
  const positive = (value) => Number.isFinite(value) && value > 0;
  if (!Array.isArray(cameras)) throw new Error("expected a list of cameras");
  cameras.forEach((camera, i) => {
    const rotation = camera?.rotation;
    const ok = numbers(camera?.position, 3) && Array.isArray(rotation) && rotation.length === 3
      && rotation.every((row) => numbers(row, 3)) && ["width", "height", "fx", "fy"].every((key) => positive(camera[key]));
    if (!ok) throw new Error(`camera ${i} has no valid position, rotation, width, height, fx and fy`);
  });
  return cameras;
}

// The direction that is upwards in most of the photographs.
export function upOf(cameras) {
  const sum = cameras.map((camera) => camera.rotation.map((row) => -row[1])).reduce((a, b) => add(a, b), [0, 0, 0]);
  return length(sum) > 1e-6 ? unit(sum) : [0, 0, 1];
}
