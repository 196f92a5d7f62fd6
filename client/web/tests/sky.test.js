// @ts-check
import assert from "node:assert/strict";
import { test } from "node:test";

import { clockText, localHour, skySecondsAfter, skySecondsAtHour, skyTimeText } from "../sky.js";

const report = {
  revision: 3,
  now: "2026-06-21T10:00:00Z",
  sky_s: 3600,
  date: "2026-06-21T10:00:00Z",
  longitude_deg: 30,
  rate: 24,
  wind_rate: 1,
  paused: false,
  sun: { azimuth_deg: 150, elevation_deg: 60 },
};

test("sky time goes on at its rate, and stands while paused", () => {
  assert.equal(skySecondsAfter(report, 10), 3840);
  assert.equal(skySecondsAfter({ ...report, paused: true }, 10), 3600);
});

test("the hour is that of the sun's place", () => {
  assert.equal(localHour(report, 0), 12);
  assert.equal(localHour(report, 150), 13);
  assert.equal(localHour({ ...report, longitude_deg: -180 }, 0), 22);
  assert.equal(localHour({ ...report, date: null }, 0), null);
});

test("a chosen hour is a sky time of the same day", () => {
  assert.equal(skySecondsAtHour(report, 0, 18), 3600 + 6 * 3600);
  assert.equal(skySecondsAtHour(report, 0, 6), 3600 - 6 * 3600);
});

test("hours and sky times are written for people", () => {
  assert.equal(clockText(6.5), "06:30");
  assert.equal(clockText(23.999), "23:59");
  assert.equal(clockText(24), "00:00");
  assert.equal(skyTimeText(93784), "1 d 02:03:04");
  assert.equal(skyTimeText(-61), "−00:01:01");
});
