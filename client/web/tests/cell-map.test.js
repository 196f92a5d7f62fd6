// @ts-check
import assert from "node:assert/strict";
import { test } from "node:test";

import { colourOf, layoutMap, lengthText, roundLength } from "../cell-map.js";

/** @type {import("../cell-map.js").Cell[]} */
const cells = [
  { id: 1, name: "plaza", reference_m: [0, 2, 0], radius_m: 500, placed: true, viewers: [7] },
  { id: 2, name: "formed-2", reference_m: [4000, 2, 1000], radius_m: 3000, placed: false, viewers: [8] },
];
/** @type {import("../cell-map.js").Viewer[]} */
const viewers = [
  { id: 7, cell: 1, position_m: [100, 2, -200], yaw_deg: 90 },
  { id: 8, cell: 2, position_m: [4000, 1502, 1000], yaw_deg: 0 },
  { id: 9, cell: null, position_m: null, yaw_deg: null },
];

test("east is right, north is up, and one scale holds for all", () => {
  const { cells: [plaza, formed], viewers: [walker], metres_per_pixel } = layoutMap(cells, viewers, 7, 800, 600);
  const near = (/** @type {number} */ a, /** @type {number} */ b) => assert.ok(Math.abs(a - b) < 1e-9, `${a} ${b}`);
  near((formed.x - plaza.x) * metres_per_pixel, 4000);
  near((formed.y - plaza.y) * metres_per_pixel, 1000);
  near((walker.x - plaza.x) * metres_per_pixel, 100);
  assert.ok(walker.y < plaza.y, "north is up");
  near(formed.radius * metres_per_pixel, 3000);
});

test("everything is inside the map", () => {
  for (const [width, height] of [
    [800, 600],
    [300, 700],
  ]) {
    const layout = layoutMap(cells, viewers, 7, width, height);
    for (const { x, y, radius } of layout.cells) {
      assert.ok(x - radius >= 0 && x + radius <= width && y - radius >= 0 && y + radius <= height);
    }
  }
});

test("a viewer whose place is not known is left out, one far up says so, and one's own is named", () => {
  const { viewers: shown } = layoutMap(cells, viewers, 7, 800, 600);
  assert.deepEqual(
    shown.map(({ id, label, own }) => [id, label, own]),
    [
      [7, "you", true],
      [8, "1.5 km up", false],
    ],
  );
  assert.equal(shown[1].colour, colourOf(2));
});

test("an empty sky has an empty map", () => {
  const layout = layoutMap([], [], null, 800, 600);
  assert.deepEqual([layout.cells, layout.viewers], [[], []]);
  assert.ok(Number.isFinite(layout.metres_per_pixel));
});

test("lengths are round and have their unit", () => {
  assert.deepEqual([1, 1.9, 2, 49, 73, 999, 4321].map(roundLength), [1, 1, 2, 20, 50, 500, 2000]);
  assert.deepEqual([20, 500, 1000, 12345].map(lengthText), ["20 m", "500 m", "1 km", "12.3 km"]);
});

test("a cell says what its viewers share, where there are two", () => {
  const pair = { ...cells[0], viewers: [7, 8], overlap: 0.754 };
  const [both, alone] = layoutMap([pair, { ...cells[1], overlap: 0 }], viewers, 7, 800, 600).cells;
  assert.equal(both.label, "plaza · 2 · 75 % shared");
  assert.equal(both.shared, 0.754);
  assert.equal(alone.label, "formed-2 · 1");
});
