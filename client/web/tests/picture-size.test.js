import assert from "node:assert/strict";
import test from "node:test";
import { isSoftwareAdapter, pictureSize } from "../picture-size.js";

const software = { adapter: "llvmpipe (LLVM 15.0.6, 256 bits)", max_width: 3840, max_height: 2160 };
const gpu = { adapter: "NVIDIA RTX A6000", max_width: 3840, max_height: 2160 };
const stage = { width: 1920, height: 1080 };

test("a software adapter gets the area of 960 × 540 in the stage's aspect", () => {
  assert.deepEqual(pictureSize("auto", stage, software), { width: 960, height: 540 });
  const portrait = pictureSize("auto", { width: 720, height: 1280 }, software);
  assert.equal((portrait.width / portrait.height).toFixed(2), "0.56");
  assert.ok(portrait.width * portrait.height < 960 * 540 * 1.01);
});

test("before the welcome the page is modest, a real adapter gets every pixel", () => {
  assert.deepEqual(pictureSize("auto", stage, null), { width: 960, height: 540 });
  assert.deepEqual(pictureSize("auto", stage, gpu), stage);
});

test("a small stage is not blown up", () => {
  assert.deepEqual(pictureSize("auto", { width: 360, height: 301 }, software), { width: 360, height: 302 });
});

test("the server's limits hold, with the aspect kept", () => {
  const small = { ...gpu, max_width: 1280, max_height: 720 };
  assert.deepEqual(pictureSize("fit", { width: 3840, height: 1080 }, small), { width: 1280, height: 360 });
  assert.deepEqual(pictureSize("1920x1080", stage, small), { width: 1280, height: 720 });
  assert.deepEqual(pictureSize("640x360", stage, small), { width: 640, height: 360 });
});

test("two eyes share the stage, the pixels and the server's limit", () => {
  assert.deepEqual(pictureSize("fit", stage, gpu, 2), { width: 960, height: 1080 });
  const { width, height } = pictureSize("auto", stage, software, 2);
  assert.ok(2 * width * height < 960 * 540 * 1.01 && 2 * width * height > 960 * 540 * 0.97, `${width} × ${height}`);
  assert.deepEqual(pictureSize("640x360", stage, gpu, 2), { width: 640, height: 360 });
  assert.deepEqual(pictureSize("3840x2160", stage, gpu, 2), { width: 1920, height: 1080 });
});

test("a stage without extent still asks for a lawful picture", () => {
  const { width, height } = pictureSize("auto", { width: 0, height: 0 }, software);
  assert.ok(width >= 1 && height >= 1, `${width} × ${height}`);
});

test("software drivers are known by name", () => {
  assert.ok(["llvmpipe (LLVM 15)", "SwiftShader Device", "Microsoft Basic Render Driver"].every(isSoftwareAdapter));
  assert.ok(!["Intel(R) Arc(tm) A770", "Apple M2", "AMD Radeon RX 7900"].some(isSoftwareAdapter));
});
