import assert from "node:assert/strict";
import test from "node:test";

import { axes, lookUp, warpBetween, withMargin } from "../warp.js";

const camera = (yaw_deg, pitch_deg, vertical_fov_deg = 60) => ({ position_m: [0, 2, 0], yaw_deg, pitch_deg, vertical_fov_deg });
const size = { width: 160, height: 90 };
const near = (found, wanted, within = 1e-9) => found.forEach((value, i) => assert.ok(Math.abs(value - wanted[i]) < within, `${found} is not ${wanted}`));

test("axes are north, east and up as the protocol says", () => {
  near(axes(camera(0, 0))[2], [0, 0, -1]);
  near(axes(camera(90, 0))[2], [1, 0, 0]);
  near(axes(camera(0, 90))[2], [0, 1, 0]);
  near(axes(camera(90, 0))[0], [0, 0, 1]);
  for (const [yaw, pitch] of [[20, 50], [200, -70]]) {
    const [right, up, ahead] = axes(camera(yaw, pitch));
    const cross = [right[1] * ahead[2] - right[2] * ahead[1], right[2] * ahead[0] - right[0] * ahead[2], right[0] * ahead[1] - right[1] * ahead[0]];
    near(cross, up);
  }
});

test("the same camera sees the picture as it is", () => {
  const warp = warpBetween(camera(33, 12), size, camera(33, 12), size);
  for (const [x, y] of [[0, 0], [0.25, 0.7], [1, 1]]) near(lookUp(warp, x, y), [x, y]);
});

test("a turn to the right shows what was further right, a look up what was higher", () => {
  const [right] = lookUp(warpBetween(camera(0, 0), size, camera(5, 0), size), 0.5, 0.5);
  assert.ok(right > 0.5 && right < 0.6, `${right}`);
  const [, down] = lookUp(warpBetween(camera(0, 0), size, camera(0, 5), size), 0.5, 0.5);
  assert.ok(down < 0.5 && down > 0.4, `${down}`);
});

test("a place is found where its direction is", () => {
  // What stands in the middle of the shown picture is its camera's direction: project that by hand.
  const [from, to] = [camera(10, 20), camera(18, 14)];
  const ahead = axes(to)[2];
  const [r, u, f] = axes(from).map((axis) => axis[0] * ahead[0] + axis[1] * ahead[1] + axis[2] * ahead[2]);
  const tan = Math.tan(Math.PI / 6);
  near(lookUp(warpBetween(from, size, to, size), 0.5, 0.5), [0.5 + r / f / tan / (16 / 9) / 2, 0.5 - u / f / tan / 2]);
});

test("half the field of view shows the middle half", () => {
  const narrow = (2 * Math.atan(Math.tan(Math.PI / 6) / 2) * 180) / Math.PI;
  near(lookUp(warpBetween(camera(0, 0), size, camera(0, 0, narrow), size), 0, 1), [0.25, 0.75]);
});

test("a picture with a margin holds the shown one at the same scale, in whole pixels", () => {
  const { camera: asked, size: large } = withMargin(camera(0, 10), { width: 480, height: 270 }, 0.15, { width: 3840, height: 2160 });
  assert.deepEqual(large, { width: 552, height: 310 });
  const warp = warpBetween(asked, large, camera(0, 10), { width: 480, height: 270 });
  near(lookUp(warp, 0, 0).map((at, i) => at * [552, 310][i]), [36, 20]);
  near(lookUp(warp, 1, 1).map((at, i) => at * [552, 310][i]), [516, 290]);
});

test("a margin never goes beyond what the server gives, nor below what is shown", () => {
  const { size: large } = withMargin(camera(0, 0), { width: 640, height: 359 }, 0.5, { width: 700, height: 300 });
  assert.deepEqual(large, { width: 700, height: 359 });
  const { camera: wide } = withMargin(camera(0, 0, 170), { width: 64, height: 64 }, 0.5, { width: 3840, height: 2160 });
  assert.ok(wide.vertical_fov_deg <= 170);
});
