import assert from "node:assert/strict";
import test from "node:test";
import { mapPath, refusal, weatherLayers } from "../maps.js";

test("only layers of weather have maps", () => {
  const layers = [
    { name: "fog", density: { model: "homogeneous" } },
    { name: "low", density: { model: "weather" } },
    { name: "high & thin", density: { model: "weather" } },
  ];
  assert.deepEqual(weatherLayers({ layers }), ["low", "high & thin"]);
  assert.deepEqual(weatherLayers({}), []);
});

test("a layer's name may hold anything", () => {
  assert.equal(mapPath("type", "high & thin", { transition_s: "5" }), "api/v1/scene/maps/type?layer=high+%26+thin&transition_s=5");
});

test("a refusal is told in the server's words, or by its status", async () => {
  assert.equal(await refusal(new Response('{"detail": "the value NaN in column 1"}', { status: 422 })), "the value NaN in column 1");
  assert.equal(await refusal(new Response("<html>", { status: 502 })), "the server answers 502");
});
