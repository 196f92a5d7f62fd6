// @ts-check
import assert from "node:assert/strict";
import { test } from "node:test";

import { tick, viridis } from "../views.js";

test("the scale's colours are viridis, dark violet to yellow, ever lighter", () => {
  // matplotlib's viridis at 0, 0.5 and 1.
  for (const [share, expected] of /** @type {[number, number[]][]} */ ([
    [0, [68, 1, 84]],
    [0.5, [33, 145, 140]],
    [1, [253, 231, 37]],
  ])) {
    viridis(share).forEach((value, channel) => assert.ok(Math.abs(value - expected[channel]) <= 5, `${share}: ${value}`));
  }
  let before = -1;
  for (let share = 0; share <= 1; share += 0.05) {
    const [red, green, blue] = viridis(share);
    const light = 0.2126 * red + 0.7152 * green + 0.0722 * blue;
    assert.ok(light > before);
    before = light;
  }
});

test("ticks are numbers with their unit, at equal ratios on a logarithmic scale", () => {
  const distance = { low: 0.5, high: 200, unit: "km", logarithmic: true };
  assert.equal(tick(distance, 0), "0.5 km");
  assert.equal(tick(distance, 0.5), "10 km");
  assert.equal(tick(distance, 1), "200 km");
  assert.equal(tick({ low: 0, high: 1, unit: "", logarithmic: false }, 0.5), "0.5");
});
