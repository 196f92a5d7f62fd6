import assert from "node:assert/strict";
import test from "node:test";
import { FOV_LIMITS_DEG, compassPoint, dragged, keyed, wrapYaw, zoomed } from "../look.js";

const camera = Object.freeze({ position_m: [0, 2, 0], yaw_deg: 0, pitch_deg: 0, vertical_fov_deg: 60 });
const DEG = Math.PI / 180;
const near = (actual, expected, tolerance = 1e-9) => assert.ok(Math.abs(actual - expected) <= tolerance, `${actual} is not ${expected}`);

test("dragging to the right turns left, dragging down looks up", () => {
  const turned = dragged(camera, 50, 20, 360);
  assert.ok(turned.yaw_deg > 180, "from north to the west");
  assert.ok(turned.pitch_deg > 0);
});

test("what is under the pointer in the middle stays under it", () => {
  const height_px = 360;
  const focal_px = height_px / 2 / Math.tan(30 * DEG);
  near(360 - dragged(camera, 100, 0, height_px).yaw_deg, Math.atan(100 / focal_px) / DEG);
  // Half the height is half the field of view.
  near(dragged(camera, 0, height_px / 2, height_px).pitch_deg, 30);
});

test("a drag and the same drag back end where they began", () => {
  let moved = camera;
  for (let i = 0; i < 100; i += 1) moved = dragged(moved, 3, 0, 400);
  for (let i = 0; i < 100; i += 1) moved = dragged(moved, -3, 0, 400);
  near(Math.min(moved.yaw_deg, 360 - moved.yaw_deg), 0, 1e-6);
});

test("pitch never leaves ±90°, and the zenith does not spin", () => {
  const up = dragged({ ...camera, pitch_deg: 89 }, 0, 1e6, 360);
  assert.equal(up.pitch_deg, 90);
  const spun = dragged(up, 10, 0, 360);
  assert.ok(360 - spun.yaw_deg < 10);
  assert.equal(dragged({ ...camera, pitch_deg: -89 }, 0, -1e6, 360).pitch_deg, -90);
});

test("a picture without height turns nothing into NaN", () => {
  assert.ok(Number.isFinite(dragged(camera, 5, 5, 0).yaw_deg));
});

test("zooming in and out again is no change, and the limits hold", () => {
  near(zoomed(zoomed(camera, 1.7), 1 / 1.7).vertical_fov_deg, 60);
  assert.ok(zoomed(camera, 2).vertical_fov_deg < 60);
  assert.equal(zoomed(camera, 1e9).vertical_fov_deg, FOV_LIMITS_DEG.min);
  assert.equal(zoomed(camera, 1e-9).vertical_fov_deg, FOV_LIMITS_DEG.max);
});

test("arrow keys turn, Home leads home, other keys are left to the page", () => {
  assert.equal(keyed(camera, "ArrowRight", camera)?.yaw_deg, 5);
  assert.equal(keyed(camera, "ArrowLeft", camera)?.yaw_deg, 355);
  assert.equal(keyed(camera, "ArrowUp", camera)?.pitch_deg, 5);
  assert.equal(keyed({ ...camera, pitch_deg: -89 }, "ArrowDown", camera)?.pitch_deg, -90);
  assert.deepEqual(keyed({ ...camera, yaw_deg: 77 }, "Home", camera), camera);
  assert.equal(keyed(camera, "Tab", camera), null);
});

test("yaw wraps into 0 to 360", () => {
  assert.equal(wrapYaw(-90), 270);
  assert.equal(wrapYaw(725), 5);
  assert.equal(wrapYaw(360), 0);
  assert.ok(wrapYaw(-1e-20) < 360);
});

test("compass points are those of the world's axes", () => {
  assert.deepEqual([0, 90, 180, 270, 359, 44].map(compassPoint), ["N", "E", "S", "W", "N", "NE"]);
});
