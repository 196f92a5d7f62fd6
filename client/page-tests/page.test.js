// @ts-check
/** The page's controls, its connection, and whether everybody can use it. */

import assert from "node:assert/strict";
import { readFileSync } from "node:fs";
import { createRequire } from "node:module";
import { after, before, test } from "node:test";

import { openPage, screenshot, showsFrames, startBrowser, startServer, until, whyNot } from "./support.js";

const skip = whyNot();
const AXE = readFileSync(createRequire(import.meta.url).resolve("axe-core/axe.min.js"), "utf8");
const SMALL = "?width=240&height=136&fps=5";
/** @type {Awaited<ReturnType<typeof startServer>>} */
let server;
/** @type {import("playwright-core").Browser} */
let browser;

before(async () => {
  if (skip) return;
  [server, browser] = await Promise.all([startServer(), startBrowser()]);
});
after(async () => {
  await browser?.close();
  await server?.stop();
});

/**
 * Serious findings of axe-core.
 * @param {import("playwright-core").Page} page
 */
async function findings(page) {
  await page.evaluate(AXE); // past the page's content policy, which would refuse a script element
  const { violations } = await page.evaluate(() => /** @type {any} */ (window).axe.run());
  return violations
    .filter((/** @type {any} */ found) => ["serious", "critical"].includes(found.impact))
    .map((/** @type {any} */ found) => `${found.id}: ${found.nodes.map((/** @type {any} */ node) => node.target.join(" ")).join(", ")}`);
}

/** @param {import("playwright-core").Page} page @param {string} tab */
async function openTab(page, tab) {
  if (await page.locator("#side").isHidden()) await page.locator("#side-button").click();
  await page.locator(`#tab-${tab}`).click();
}

/** @param {import("playwright-core").Page} page @returns {Promise<any>} */
const draft = (page) => page.evaluate("window.skycell.scene.editor.state.draft");

test("dark, light and narrow: no serious finding of axe, nothing wider than the window", { skip }, async () => {
  for (const { name, ...options } of /** @type {const} */ ([
    { name: "dark", colorScheme: "dark", viewport: { width: 1280, height: 800 } },
    { name: "light", colorScheme: "light", viewport: { width: 1280, height: 800 } },
    { name: "narrow", colorScheme: "dark", viewport: { width: 360, height: 740 }, hasTouch: true },
    { name: "narrow-light", colorScheme: "light", viewport: { width: 360, height: 740 }, hasTouch: true },
  ])) {
    const { page, errors, context } = await openPage(browser, server.url + SMALL, options);
    await showsFrames(page);
    await screenshot(page, `page-${name}`);
    for (const tab of ["sky", "scene", "view"]) {
      await openTab(page, tab);
      if (tab === "scene") await page.waitForSelector(".scene-panel .lil-controller");
      assert.deepEqual(await findings(page), [], `${name}, tab ${tab}`);
      await screenshot(page, `page-${name}-${tab}`);
      const wide_px = await page.evaluate(() => document.documentElement.scrollWidth);
      assert.ok(wide_px <= options.viewport.width, `${name}, tab ${tab}: ${wide_px} px`);
    }
    for (const opener of ["graph-button", "cell-map-button", "help-button"]) await page.locator(`#${opener}`).click();
    assert.deepEqual(await findings(page), [], `${name}, all open`);
    await screenshot(page, `page-${name}-help`);
    assert.deepEqual(errors, []);
    await context.close();
  }
});

test("the colours follow the system until they are chosen, and the choice stays", { skip }, async () => {
  const { page, context } = await openPage(browser, server.url + SMALL, { colorScheme: "light" });
  const ground = () => page.evaluate(() => getComputedStyle(document.body).backgroundColor);
  const light = await ground();
  await page.emulateMedia({ colorScheme: "dark" });
  const dark = await ground();
  assert.notEqual(light, dark);
  await page.locator("#theme-button").click();
  assert.equal(await ground(), light);
  await page.reload();
  assert.equal(await ground(), light);
  await page.locator("#theme-button").click();
  assert.equal(await ground(), dark);
  await context.close();
});

test("every number of the schema has a row with its unit and a slider that a keyboard moves", { skip }, async () => {
  const { page, errors, context } = await openPage(browser, server.url + SMALL);
  await openTab(page, "scene");
  await page.waitForSelector(".scene-panel .lil-controller");
  const missing = await page.evaluate(async () => {
    const openapi = await (await fetch("api/v1/openapi.json")).json();
    const scene = await (await fetch("api/v1/scene")).json();
    const { panelOf } = await import(/** @type {any} */ ("/scene-schema.js"));
    /** @param {any} field @returns {any[]} */
    const numbers = (field) => (field.kind === "number" ? [field] : (field.children ?? []).flatMap(numbers));
    const all = panelOf(openapi, scene).flatMap((/** @type {any} */ { fields }) => fields.flatMap(numbers));
    const rowless = all.filter((/** @type {any} */ field) => {
      const row = document.querySelector(`[data-path="${field.path.join("/")}"]`);
      return !row || !row.querySelector("input.slide") || row.querySelector(".unit")?.textContent !== field.unit;
    });
    return { count: all.length, rowless: rowless.map((/** @type {any} */ { path }) => path.join("/")) };
  });
  assert.deepEqual(missing.rowless, []);
  assert.ok(missing.count >= 30, `${missing.count} numbers`);
  const row = page.locator('[data-path="sun/elevation_deg"]');
  assert.equal(await row.locator(".unit").textContent(), "°");
  const slider = row.getByRole("slider");
  const before = (await draft(page)).sun.elevation_deg;
  await slider.focus();
  for (let i = 0; i < 20; i += 1) await page.keyboard.press("ArrowRight");
  await until(page, (was) => /** @type {any} */ (window).skycell.scene.editor.state.document.sun.elevation_deg > was, before);
  assert.ok((await server.get("api/v1/scene")).sun.elevation_deg > before);
  assert.deepEqual(errors, []);
  await context.close();
});

test("a dragged slider sends few patches, the last value wins, undo and the reset of one value take it back", { skip }, async () => {
  const { page, errors, context } = await openPage(browser, server.url + SMALL);
  await openTab(page, "scene");
  const row = page.locator('[data-path="layers/0/density/coverage"]');
  await row.waitFor();
  const before = (await server.get("api/v1/scene")).layers[0].density.coverage;
  const newest = async () => (await server.get("api/v1/scene/revisions?limit=1")).revisions[0];
  const revision_before = (await newest()).revision;
  const moves = 60;
  const sent = await page.evaluate(async (count) => {
    const { editor } = /** @type {any} */ (window).skycell.scene;
    const slider = /** @type {HTMLInputElement} */ (document.querySelector('[data-path="layers/0/density/coverage"] .slide'));
    const already = editor.requests;
    for (let i = 1; i <= count; i += 1) {
      slider.value = String(500 + i * 5);
      slider.dispatchEvent(new Event("input"));
      await new Promise((resolve) => setTimeout(resolve, 10));
    }
    slider.dispatchEvent(new Event("change"));
    return editor.requests - already;
  }, moves);
  assert.ok(sent <= moves / 4, `${sent} patches of ${moves} movements`);
  await until(page, "window.skycell.scene.editor.state.document.layers[0].density.coverage === 0.8");
  const scene = await server.get("api/v1/scene");
  assert.equal(scene.layers[0].density.coverage, 0.8);
  assert.equal(scene.layers[0].density.pattern, (await draft(page)).layers[0].density.pattern);
  // To whoever looks back it is one revision.
  const drag = await newest();
  assert.equal(drag.first, revision_before + 1);
  assert.ok(drag.revision > drag.first, JSON.stringify(drag));
  // Undo: the whole drag is one step.
  await page.locator("#undo").click();
  await until(page, (was) => /** @type {any} */ (window).skycell.scene.editor.state.document.layers[0].density.coverage === was, before);
  assert.equal((await server.get("api/v1/scene")).layers[0].density.coverage, before);
  // One value back, by its own button.
  const input = row.locator("input:not(.slide)");
  await input.fill("0.7");
  await input.press("Enter");
  await until(page, "window.skycell.scene.editor.state.document.layers[0].density.coverage === 0.7");
  await row.getByRole("button", { name: /back to/ }).click();
  await until(page, "window.skycell.scene.editor.state.document.layers[0].density.coverage === 0.45");
  assert.deepEqual(errors, []);
  await context.close();
});

test("who has not seen somebody else's change does not overwrite it, and is told", { skip }, async () => {
  const { page, context } = await openPage(browser, server.url + SMALL);
  await openTab(page, "scene");
  const row = page.locator('[data-path="sun/azimuth_deg"]');
  await row.waitFor();
  // The other's change comes between the slider's movement and the page's request: hold the page's news back.
  await page.evaluate(() => {
    const { editor } = /** @type {any} */ (window).skycell.scene;
    editor.load = () => {
      document.documentElement.dataset.heldBack = "yes";
      return Promise.resolve();
    };
  });
  await server.patch({ exposure_ev: 1.25 });
  await page.waitForSelector("html[data-held-back]");
  const input = row.locator("input:not(.slide)");
  await page.evaluate(() => delete (/** @type {any} */ (window).skycell.scene.editor.load));
  await input.fill("77");
  await input.press("Enter");
  await until(page, "/Somebody else/.test(document.getElementById('scene-told').textContent)");
  const scene = await server.get("api/v1/scene");
  assert.equal(scene.exposure_ev, 1.25);
  assert.notEqual(scene.sun.azimuth_deg, 77);
  assert.equal((await draft(page)).exposure_ev, 1.25);
  // Now it has been seen.
  await input.fill("77");
  await input.press("Enter");
  await until(page, "window.skycell.scene.editor.state.document.sun.azimuth_deg === 77");
  await context.close();
});

test("a layer is added by its family and removed, a value out of range is brought into it", { skip }, async () => {
  const { page, errors, context } = await openPage(browser, server.url + SMALL);
  await openTab(page, "scene");
  await page.locator('[data-path="add-layer"] select').selectOption("cirrus");
  await until(page, "window.skycell.scene.editor.state.document.layers.length === 2");
  assert.equal((await server.get("api/v1/scene")).layers[1].density.model, "cirrus");
  await page.locator(".lil-title", { hasText: "Layer cirrus" }).click();
  await page.getByRole("button", { name: "Remove layer cirrus" }).click();
  await until(page, "window.skycell.scene.editor.state.document.layers.length === 1");
  const input = page.locator('[data-path="sun/elevation_deg"] input:not(.slide)');
  await input.fill("1000");
  await input.press("Enter");
  await until(page, "window.skycell.scene.editor.state.document.sun.elevation_deg === 90");
  assert.equal(await input.inputValue(), "90");
  await page.locator("#reset").click();
  await until(page, "window.skycell.scene.editor.state.document.sun.elevation_deg === 40");
  assert.deepEqual(errors, []);
  await context.close();
});

test("a preset's picture sets it with its camera, and values are then reset to it", { skip }, async () => {
  const { page, errors, context } = await openPage(browser, server.url + SMALL);
  await openTab(page, "sky");
  await page.locator("#transition").selectOption("0");
  const card = page.locator('.card[data-preset="cirrus-evening"]');
  await card.click();
  const loaded = await card.locator("img").evaluate((image) => /** @type {HTMLImageElement} */ (image).naturalWidth);
  assert.equal(loaded, 192);
  await until(page, "window.skycell.camera.yaw_deg === 268");
  assert.equal(await card.getAttribute("aria-pressed"), "true");
  await until(page, "window.skycell.scene.editor.state.document.layers.some((layer) => layer.density.model === 'cirrus')");
  assert.equal(await page.locator("#reset-to").inputValue(), "cirrus-evening");
  const preset = (await server.get("api/v1/presets/cirrus-evening")).scene;
  await openTab(page, "scene");
  const input = page.locator('[data-path="sun/elevation_deg"] input:not(.slide)');
  await input.fill("33");
  await input.press("Enter");
  await until(page, "window.skycell.scene.editor.state.document.sun.elevation_deg === 33");
  await page.locator("#reset").click();
  await until(page, (wanted) => /** @type {any} */ (window).skycell.scene.editor.state.document.sun.elevation_deg === wanted, preset.sun.elevation_deg);
  assert.deepEqual(errors, []);
  await page.locator("#reset-to").selectOption("");
  await page.locator("#reset").click();
  await until(page, "window.skycell.scene.editor.state.document.sun.elevation_deg === 40");
  await server.patch({ wind: { speed_m_per_s: 0 } });
  await context.close();
});

test("keys, help, screenshot, and the bar of the day", { skip }, async () => {
  const { page, errors, context } = await openPage(browser, server.url + SMALL, { acceptDownloads: true });
  await showsFrames(page);
  await page.locator("body").press("?");
  assert.ok(await page.locator("#help-dialog").isVisible());
  await page.keyboard.press("Escape");
  assert.ok(await page.locator("#help-dialog").isHidden());
  const [download] = await Promise.all([page.waitForEvent("download"), page.locator("#snapshot-button").click()]);
  assert.match(download.suggestedFilename(), /^skycell-.*\.png$/);
  const png = readFileSync(await download.path());
  assert.deepEqual([png.readUInt32BE(16), png.readUInt32BE(20)], [240, 136]);
  // Noon: the sun stands by the clock from then on.
  await page.locator("#noon").click();
  await until(page, "/^1[12]:/.test(document.getElementById('hour-text').textContent)");
  const time = await server.get("api/v1/scene/time");
  assert.ok(time.date !== null && Math.abs(time.sun.azimuth_deg - 180) < 5, JSON.stringify(time));
  await page.locator("#dusk").click();
  const low = async () => (await server.get("api/v1/scene/time")).sun.elevation_deg;
  await until(page, "/^1[6-9]:|^2/.test(document.getElementById('hour-text').textContent)");
  assert.ok(Math.abs(await low()) < 2.5, `${await low()}° at dusk`);
  // Undo takes the clock back, too: to noon, and to the sun that stands by hand.
  await page.keyboard.press("Control+z");
  await until(page, "/^1[12]:/.test(document.getElementById('hour-text').textContent)");
  await page.keyboard.press("Control+z");
  await until(page, "document.getElementById('hour-text').textContent === 'by hand'");
  assert.equal((await server.get("api/v1/scene")).sun.place_and_time, null);
  await page.locator("#picture").focus();
  await page.keyboard.press("h");
  assert.ok(await page.locator(".foot").isHidden());
  await page.keyboard.press("h");
  await page.keyboard.press("l");
  assert.ok(await page.locator("#graph").isVisible());
  assert.deepEqual(errors, []);
  await context.close();
  await server.patch({ sun: null });
});

test("a view of one quantity comes with its legend", { skip }, async () => {
  const { page, context } = await openPage(browser, `${server.url}${SMALL}&show=transmittance`);
  await showsFrames(page);
  await page.waitForSelector("#legend:not([hidden])");
  assert.equal(await page.locator("#legend-high").textContent(), "1");
  await context.close();
});

test("two tabs share a cell, both come back after the server was started anew, and say so meanwhile", { skip }, async () => {
  const first = await openPage(browser, server.url + SMALL);
  const second = await openPage(browser, server.url + SMALL);
  for (const { page } of [first, second]) {
    await showsFrames(page);
    await until(page, "window.skycell.status.server.viewers_in_cell === 2 && window.skycell.status.server.overlap > 0")
      .catch(async () => assert.fail(JSON.stringify(await page.evaluate("window.skycell.status.server"))));
  }
  await second.context.close();
  const { page, context } = first;
  const { port, state } = server;
  await server.stop(true);
  await until(page, "/^(Connection lost|No connection|Connecting again)/.test(document.getElementById('state').textContent)");
  assert.equal(await page.evaluate("document.documentElement.dataset.state !== 'open'"), true);
  await screenshot(page, "page-lost");
  const drawn = Number(await page.evaluate("window.skycell.counts.drawn"));
  server = await startServer({ port, state });
  await until(page, (before) => /** @type {any} */ (window).skycell.status.state === "open" && /** @type {any} */ (window).skycell.counts.drawn > before, drawn, { timeout: 40_000 });
  assert.equal(await page.locator("#state").textContent(), "Connected");
  await context.close();
});
