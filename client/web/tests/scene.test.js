import assert from "node:assert/strict";
import test from "node:test";

import { mergePatch, scenePatch, withValue } from "../scene-edit.js";
import { labelOf, panelOf, rounded, shapeOf, sliderScale } from "../scene-schema.js";
import { sunHours } from "../sky.js";
import { OPENAPI } from "./scene-schema.sample.js";

const SCENE = {
  version: 1,
  planet: { radius_m: 6.36e6, ground_albedo: 0.1 },
  sun: { azimuth_deg: 150, elevation_deg: 40, place_and_time: null, irradiance_w_per_m2_nm: [1.474, 1.8504, 1.91198] },
  moon: null,
  atmosphere: { model: "analytic", aerosol_optical_depth: 0.08 },
  layers: [
    {
      family: null,
      name: "low",
      base_altitude_m: 1500,
      top_altitude_m: 4000,
      density: { model: "weather", pattern: "puffs", coverage: 0.45, seed: 1, maps: {} },
      extinction_per_m: 0.05,
      wind: null,
    },
  ],
  wind: { towards_deg: 90, speed_m_per_s: 5 },
  exposure_ev: 0,
  tone: { curve: "aces" },
  quality: null,
  time: { rate: 1 },
};

const fields = (panel) => {
  const found = new Map();
  const walk = (field) => {
    found.set(field.path.join("/"), field);
    for (const child of field.children ?? []) walk(child);
  };
  for (const { fields } of panel) fields.forEach(walk);
  return found;
};

test("every number of the schema is a field with its range, default and unit", () => {
  const found = fields(panelOf(OPENAPI, SCENE));
  const { kind, value, min, max, unit, label, fallback, about } = found.get("sun/elevation_deg");
  assert.deepEqual(
    [kind, value, min, max, unit, label, fallback],
    ["number", 40, -90, 90, "°", "Elevation", 40],
  );
  assert.match(about, /Above the horizon/);
  assert.equal(found.get("layers/0/extinction_per_m").unit, "1/m");
  assert.equal(found.get("layers/0/density/seed").whole, true);
  assert.deepEqual([0, 1, 2].map((i) => found.get(`sun/irradiance_w_per_m2_nm/${i}`).label), ["Red", "Green", "Blue"]);
  assert.equal(found.get("sun/irradiance_w_per_m2_nm/1").fallback, 1.8504);
});

test("words are choices, models are told apart, and what is not there can be switched on", () => {
  const found = fields(panelOf(OPENAPI, SCENE));
  assert.deepEqual(found.get("tone/curve").names, ["aces", "agx", "neutral"]);
  assert.deepEqual(found.get("atmosphere/model").names, ["analytic", "physical"]);
  assert.equal(found.get("layers/0/density/model").value, "weather");
  assert.deepEqual(found.get("layers/0/family").names, ["", "cumulus", "stratus", "cirrus"]);
  const moon = found.get("moon");
  assert.deepEqual([moon.optional, moon.present, moon.children.length], [true, false, 0]);
  assert.deepEqual([found.get("planet").optional, found.get("planet").present], [true, true]);
});

test("fields stand in the order of documents", () => {
  const wind = panelOf(OPENAPI, SCENE).find(({ title }) => title === "Wind").fields[0];
  assert.deepEqual(wind.children.map(({ label }) => label), ["Speed", "Towards"]);
});

test("what servers write and what stands elsewhere on the page is no field", () => {
  const found = fields(panelOf(OPENAPI, SCENE));
  for (const path of ["version", "time", "quality", "sun/place_and_time", "layers/0/density/maps"]) assert.ok(!found.has(path), path);
});

test("a key that this page does not know is shown all the same", () => {
  const schema = structuredClone(OPENAPI);
  schema.components.schemas.Scene.properties.fog_depth_m = { type: "number", minimum: 0, maximum: 10, "x-unit": "m" };
  const panel = panelOf(schema, { ...SCENE, fog_depth_m: 3 });
  assert.equal(panel.at(-1).title, "More");
  assert.equal(panel.at(-1).fields[0].label, "Fog depth");
});

test("the shape changes with models and layers, not with values", () => {
  const shape = (scene) => shapeOf(panelOf(OPENAPI, scene));
  assert.equal(shape(SCENE), shape(withValue(SCENE, ["sun", "elevation_deg"], 3)));
  assert.notEqual(shape(SCENE), shape({ ...SCENE, moon: { elevation_deg: 3, of_place_and_time: false } }));
  assert.notEqual(shape(SCENE), shape({ ...SCENE, layers: [] }));
});

test("labels leave units out", () => {
  assert.equal(labelOf("base_altitude_m"), "Base altitude");
  assert.equal(labelOf("speed_m_per_s"), "Speed");
  assert.equal(labelOf("ground_albedo"), "Ground albedo");
});

test("a slider's place and value are each other's inverse, its ends are the range's, and what is common is in its middle", () => {
  for (const field of [
    { min: 0, max: 1, fallback: 0.45, value: 0.45 },
    { min: 0, max: 1000, fallback: 0.05, value: 0.05 },
    { min: -1e6, max: 1e6, fallback: 0, value: 20 },
    { min: 1e4, max: 1e8, fallback: 6.36e6, value: 1e5 },
    { min: -0.95, max: 0.95, fallback: 0.8, value: 0 },
    { min: 1, max: 64, fallback: 6, value: 6 },
  ]) {
    const { valueAt, placeOf } = sliderScale(field);
    const close = (a, b) => assert.ok(Math.abs(a - b) <= 1e-6 * (field.max - field.min), `${a} is not ${b} of ${JSON.stringify(field)}`);
    close(valueAt(0), field.min);
    close(valueAt(1), field.max);
    for (const at of [0.1, 0.5, 0.77]) assert.ok(Math.abs(placeOf(valueAt(at)) - at) < 1e-6);
    close(valueAt(placeOf(field.value)), field.value);
  }
  const place = sliderScale({ min: 0, max: 1000, fallback: 0.05, value: 0.05 }).placeOf(0.05);
  assert.ok(place > 0.4 && place < 0.6, `${place}`);
  assert.equal(rounded(0.123456, false), 0.123);
  assert.equal(rounded(2.6, true), 3);
});

test("a merge patch says what differs, and nothing where nothing does", () => {
  assert.equal(mergePatch(SCENE, structuredClone(SCENE)), undefined);
  assert.deepEqual(mergePatch(SCENE, withValue(SCENE, ["sun", "elevation_deg"], 5)), { sun: { elevation_deg: 5 } });
  // Lists as a whole, keys of another model away.
  const other = withValue(SCENE, ["layers", 0, "density", "coverage"], 0.9);
  assert.deepEqual(mergePatch(SCENE, other), { layers: other.layers });
  const air = { ...SCENE, atmosphere: { model: "physical" } };
  assert.deepEqual(mergePatch(SCENE, air), { atmosphere: { model: "physical", aerosol_optical_depth: null } });
  assert.deepEqual(scenePatch(SCENE, { ...SCENE, planet: null }), { planet: "flat" });
});

test("the sun rises at six at the equator, not at all in a polar night", () => {
  const equinox = sunHours(new Date("2026-03-20T12:00:00Z"), 0);
  assert.ok(Math.abs(equinox.rise - 6.07) < 0.05 && Math.abs(equinox.set - 18.18) < 0.05, JSON.stringify(equinox));
  // Vienna on 21 June 2026: sunrise 04:54, sunset 20:58 by summer time, at 16.37° east: mean solar hours 3.99 and 20.06.
  const june = sunHours(new Date("2026-06-21T12:00:00Z"), 48.2);
  assert.ok(Math.abs(june.rise - 3.99) < 0.05 && Math.abs(june.set - 20.06) < 0.05, JSON.stringify(june));
  assert.equal(sunHours(new Date("2026-12-21T12:00:00Z"), 80).always, "night");
  assert.equal(sunHours(new Date("2026-06-21T12:00:00Z"), 80).always, "day");
});
