// node --test dpges-render/web/tests/camera.test.js
import assert from "node:assert/strict";
import test from "node:test";

import { OrbitCamera, add, cross, dot, length, parseCameras, upOf } from "../page/camera.js";

const near = (a, b, tolerance = 1e-9) => assert.ok(length(add(a, b, -1)) < tolerance, `${a} is not ${b}`);

// Where a point of the world is in the picture: right, down, forward, in world units.
function inCamera(camera, point) {
  const { right, down, forward } = camera.axes();
  const offset = add(point, camera.eye(), -1);
  return [right, down, forward].map((axis) => dot(axis, offset));
}

function somewhere() {
  const camera = new OrbitCamera([0.2, -1, 0.4]);
  Object.assign(camera, { target: [1, 2, 3], distance: 4, yaw: 0.7, pitch: -0.3 });
  return camera;
}

test("axes are right-handed, of unit length, and up is up", () => {
  const camera = somewhere();
  const { right, down, forward } = camera.axes();
  near(cross(right, down), forward);
  for (const axis of [right, down, forward]) assert.ok(Math.abs(length(axis) - 1) < 1e-12);
  assert.ok(Math.abs(dot(right, camera.up)) < 1e-12 && dot(down, camera.up) < 0);
  near(inCamera(camera, camera.target), [0, 0, 4]);
});

test("what is in front of the target follows the hand", () => {
  const camera = somewhere();
  const point = add(camera.target, camera.axes().forward, -1);
  camera.turn(-0.1, 0);
  assert.ok(inCamera(camera, point)[0] > 0.05, "dragged to the right");
  const other = somewhere();
  other.turn(0, -0.1);
  assert.ok(inCamera(other, point)[1] > 0.05, "dragged down");
});

test("the camera never turns over", () => {
  const camera = somewhere();
  camera.turn(0, 10);
  assert.ok(camera.pitch < Math.PI / 2 && dot(camera.axes().down, camera.up) < 0);
});

test("a camera of the file is met, but for its roll", () => {
  const original = somewhere();
  const entry = original.entry(640, 360);
  const camera = new OrbitCamera(original.up);
  camera.place(entry, original.target, 1);
  near(camera.eye(), original.eye());
  near(camera.axes().forward, original.axes().forward);
  near(camera.axes().right, original.axes().right);
  assert.ok(Math.abs(camera.focal(640, 360) - entry.fx) < 1e-9);
  near(upOf([entry]), original.axes().down.map((value) => -value));
});

test("the whole field stays in the picture", () => {
  const camera = somewhere();
  camera.field = [0.8, 0.45];
  assert.ok(Math.abs(camera.focal(800, 450) - 500) < 1e-9);
  assert.ok(Math.abs(camera.focal(450, 800) - 450 / 1.6) < 1e-9);
  camera.fieldDegrees = 90;
  assert.ok(Math.abs(camera.field[0] - 0.8 / 0.45) < 1e-9 && Math.abs(camera.fieldDegrees - 90) < 1e-9);
});

test("a sphere is fitted into the narrower side", () => {
  const camera = new OrbitCamera();
  camera.fit([5, 0, 0], 2);
  const top = add([5, 0, 0], camera.axes().down, -2);
  const [, y, z] = inCamera(camera, top);
  assert.ok(Math.abs(y / z) < camera.field[1]);
  near(inCamera(camera, [5, 0, 0]), [0, 0, camera.distance]);
});

test("a glide ends, and ends at the same place however often it is drawn", () => {
  const run = (seconds) => {
    const camera = somewhere();
    camera.speed.yaw = 2;
    let frames = 0;
    while (camera.glide(seconds)) frames += 1;
    assert.ok(frames < 1e4 && !camera.gliding());
    return camera.yaw;
  };
  assert.ok(Math.abs(run(0.016) - run(0.004)) < 1e-3);
  assert.ok(Math.abs(run(0.016) - 0.7 - 2 * 0.16) < 1e-3);
});

test("a wrong cameras.json is refused", () => {
  assert.throws(() => parseCameras("{}"), /list of cameras/);
  assert.throws(() => parseCameras('[{"position": [0, 0], "rotation": []}]'), /camera 0/);
  const entry = somewhere().entry(64, 48);
  assert.deepEqual(parseCameras(JSON.stringify([entry])), [entry]);
});
