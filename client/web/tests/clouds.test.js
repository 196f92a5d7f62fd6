import assert from "node:assert/strict";
import { readFile } from "node:fs/promises";
import test from "node:test";
import { deflateSync } from "node:zlib";
import { CLOUDS_HEADER_BYTES, CloudsError, distancesOfClouds, floatOfHalf, floatsOfClouds, parseClouds } from "../clouds.js";

/** Of 4 x 3 pixels; the protocol's own test reads it too. */
const sample = new Uint8Array(await readFile(new URL("clouds-4x3.bin", import.meta.url)));

/** The sample's header around another stream. */
function around(inflated, { width = 4, height = 3 } = {}) {
  const data = deflateSync(inflated);
  const payload = new Uint8Array(CLOUDS_HEADER_BYTES + data.length);
  payload.set(sample.subarray(0, CLOUDS_HEADER_BYTES));
  payload.set(data, CLOUDS_HEADER_BYTES);
  const view = new DataView(payload.buffer);
  view.setUint32(4, width, true);
  view.setUint32(8, height, true);
  view.setUint32(16, data.length, true);
  return payload;
}

test("every pixel of a sample is read as it was written", async () => {
  const clouds = await parseClouds(sample);
  assert.deepEqual([clouds.width, clouds.height, clouds.pre_exposure, clouds.haze], [4, 3, 0.25, false]);
  const floats = floatsOfClouds(clouds);
  const distances_m = distancesOfClouds(clouds);
  for (let pixel = 0; pixel < 12; pixel += 1) {
    assert.deepEqual([...floats.subarray(4 * pixel, 4 * pixel + 4)], [pixel, 2 * pixel, 0.5, 1 - pixel / 16]);
    assert.equal(distances_m[pixel], 1000 * (12 - pixel));
  }
});

test("a payload is read wherever it stands in its buffer", async () => {
  const message = new Uint8Array(96 + sample.length);
  message.set(sample, 96);
  assert.deepEqual(await parseClouds(message.subarray(96)), await parseClouds(sample));
});

test("half floats are those of IEEE 754", () => {
  const cases = [[0, 0], [1, 2 ** -24], [0x3ff, 1023 * 2 ** -24], [0x400, 2 ** -14], [0x3c00, 1], [0x3555, 0.333251953125], [0x7bff, 65504], [0x8000, -0], [0xc000, -2]];
  for (const [bits, value] of cases) assert.equal(floatOfHalf(bits), value);
  assert.equal(floatOfHalf(0x7c00), Infinity);
  assert.ok(Number.isNaN(floatOfHalf(0x7e00)));
});

test("what is no picture of clouds is refused in words", async () => {
  const changed = (at, byte) => {
    const bytes = sample.slice();
    bytes[at] = byte;
    return bytes;
  };
  const cases = [
    [sample.subarray(0, 31), /at least 32 bytes/],
    [changed(0, 2), /version 2/],
    [changed(1, 4), /4 planes/],
    [changed(2, 2), /flags or reserved/],
    [changed(31, 1), /flags or reserved/],
    [changed(4, 0), /width of clouds is 0; allowed: 1 to 3840/],
    [changed(10, 1), /height of clouds is 65539; allowed: 1 to 2160/],
    [changed(12, 1), /pre_exposure/],
    [changed(15, 0xbe), /pre_exposure of clouds is -0.25/],
    [changed(15, 0x7f), /pre_exposure of clouds is Infinity/],
    [changed(16, 1), /announce 1 bytes/],
    [changed(CLOUDS_HEADER_BYTES, 0), /cannot be inflated/],
    [changed(5, 1), /instead of 7800/],
    [around(new Uint8Array(119)), /119 bytes instead of 120/],
    [around(new Uint8Array(121)), /more than 120 bytes/],
    // A bomb: given up at the first byte too many.
    [around(new Uint8Array(50_000_000)), /more than 120 bytes/],
    // Infinity in red, which is the largest difference to one side.
    [around(new Uint8Array([0xf8, 0, 0, 0, 0, 0, 0, 0, 0, 0]), { width: 1, height: 1 }), /plane 0 of clouds holds Infinity/],
    // Transmittance 2.
    [around(new Uint8Array([0, 0, 0, 0, 0, 0, 0x80, 0, 0, 0]), { width: 1, height: 1 }), /plane 3 of clouds holds 2/],
  ];
  for (const [payload, said] of cases) {
    await assert.rejects(parseClouds(payload), (error) => error instanceof CloudsError && said.test(error.message), String(said));
  }
});
