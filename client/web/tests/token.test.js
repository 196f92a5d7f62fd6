import assert from "node:assert/strict";
import test from "node:test";
import { connectionToken, isOwnApi, otherToken, withToken } from "../token.js";

test("the token goes to the own server's interface and nowhere else", () => {
  const base = "https://sky.test/north/?yaw=3";
  for (const [target, is_own] of [
    ["api/v1/scene", true],
    ["https://sky.test/north/api/v1/scene", true],
    ["https://sky.test/api/v1/scene", false],
    ["https://evil.test/north/api/v1/scene", false],
    ["http://sky.test/north/api/v1/scene", false],
    ["https://sky.test.evil.test/north/api/", false],
    ["//evil.test/north/api/v1", false],
    ["main.js", false],
    ["api/../../x", false],
  ]) {
    assert.equal(isOwnApi(target, base), is_own, target);
  }
  assert.equal(isOwnApi(new URL("https://sky.test/north/api/v1"), base), true);
});

test("a request keeps its own headers beside the token", () => {
  const init = withToken({ method: "PUT", headers: { "If-Match": "*" } }, "sky_x");
  assert.equal(init.method, "PUT");
  assert.equal(init.headers.get("authorization"), "Bearer sky_x");
  assert.equal(init.headers.get("if-match"), "*");
  assert.equal(withToken(undefined, "a").headers.get("authorization"), "Bearer a");
});

test("a refusal of an older token that comes late leaves the newer one in place, and asks for nothing", async (t) => {
  const held = new Map([["skycell-token", "sky_new"]]);
  globalThis.sessionStorage = {
    getItem: (key) => held.get(key) ?? null,
    setItem: (key, value) => held.set(key, value),
    removeItem: (key) => held.delete(key),
  };
  t.after(() => delete globalThis.sessionStorage);
  // Without a document, a dialog would throw.
  assert.equal(await otherToken("sky_old"), "sky_new");
  assert.equal(await connectionToken.refused("sky_old"), true);
  assert.equal(await connectionToken.refused(null), true);
  assert.equal(held.get("skycell-token"), "sky_new");
  // The one that is known is refused: then it is asked for.
  await assert.rejects(otherToken("sky_new"), /document/);
});
