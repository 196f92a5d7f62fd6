// @ts-check
/** A real server and a real browser for the page's tests. */

import { spawn } from "node:child_process";
import { createWriteStream, existsSync, mkdirSync, mkdtempSync, readFileSync, rmSync, writeFileSync } from "node:fs";
import os from "node:os";
import path from "node:path";
import { createInterface } from "node:readline";
import { fileURLToPath } from "node:url";
import { chromium } from "playwright-core";

import { serve } from "../dev/serve.js";

/** @typedef {import("playwright-core").Page} Page */
/** @typedef {import("playwright-core").Browser} Browser */

const REPOSITORY = path.resolve(fileURLToPath(new URL("../..", import.meta.url)));
export const SCREENSHOTS = path.join(REPOSITORY, "target", "page-screenshots");
/** With SKYCELL_PAGE=disk the page's files come from web/ instead of from the server: for work on them. By the server's port. */
/** @type {Map<number, Awaited<ReturnType<typeof serve>>>} */
const gates = new Map();
const READY_WITHIN_MS = 90_000;

/** Where the built server is: SKYCELL_BIN_DIR, or the release build, or the development build. */
function serverBinary() {
  const folders = process.env.SKYCELL_BIN_DIR
    ? [process.env.SKYCELL_BIN_DIR]
    : ["release", "debug"].map((profile) => path.join(REPOSITORY, "target", profile));
  const found = folders.map((folder) => path.join(folder, "skycell-server")).find((file) => existsSync(file));
  if (!found) throw new Error(`no skycell-server in ${folders.join(" or ")}: cargo build --release --bins`);
  return found;
}

/**
 * A server without wind, so that its sky converges.
 * @param {{ port?: number, state?: string }} [options]  where it is to listen, and what it goes on with
 */
export async function startServer({ port = 0, state } = {}) {
  const scratch = mkdtempSync(path.join(os.tmpdir(), "skycell-page-"));
  const folder = state ?? path.join(scratch, "state");
  const config = path.join(scratch, "skycell.toml");
  const noise = path.join(REPOSITORY, "target", "noise-of-tests");
  writeFileSync(config, `[render]\nnoise_cache_dir = ${JSON.stringify(noise)}\n`);
  const log = path.join(scratch, "log");
  const { SKYCELL_BIN_DIR: _ours, ...environment } = process.env;
  const child = spawn(serverBinary(), ["serve", "--listen", `127.0.0.1:${port}`, "--state", folder, "--config", config], {
    stdio: ["ignore", "pipe", "pipe"],
    env: { XDG_RUNTIME_DIR: os.tmpdir(), ...environment },
  });
  child.stderr.pipe(createWriteStream(log));
  const ended = new Promise((resolve) => child.once("exit", resolve));
  const address = await new Promise((resolve, reject) => {
    child.once("exit", (code) => reject(new Error(`the server ended with ${code}:\n${readFileSync(log, "utf8").slice(-3000)}`)));
    createInterface(child.stdout).on("line", (line) => {
      const found = /http:\/\/([0-9.:]+)/.exec(line);
      if (found) resolve(found[1]);
    });
  });
  let url = `http://${address}/`;
  const own_port = Number(new URL(url).port);
  const until_ms = Date.now() + READY_WITHIN_MS;
  while (!(await fetch(`${url}readyz`).then((answer) => answer.ok, () => false))) {
    if (Date.now() > until_ms) throw new Error(`the server is not ready:\n${readFileSync(log, "utf8").slice(-3000)}`);
    await new Promise((resolve) => setTimeout(resolve, 100));
  }
  if (process.env.SKYCELL_PAGE === "disk") {
    if (!gates.has(own_port)) gates.set(own_port, await serve({ server: url, root: "web" }));
    url = gates.get(own_port)?.url ?? url;
  }
  const server = {
    url,
    port: own_port,
    state: folder,
    /** @param {string} at */
    get: async (at) => (await fetch(url + at)).json(),
    /** @param {object} patch */
    patch: async (patch) => {
      const answer = await fetch(`${url}api/v1/scene`, {
        method: "PATCH",
        headers: { "Content-Type": "application/merge-patch+json", "If-Match": "*" },
        body: JSON.stringify(patch),
      });
      if (!answer.ok) throw new Error(await answer.text());
      return Number((answer.headers.get("etag") ?? "").replaceAll('"', ""));
    },
    /** Ends the process; what it keeps stays where somebody else brought it, or goes on with it. @param {boolean} [keep] */
    stop: async (keep = false) => {
      child.kill("SIGKILL");
      await ended;
      if (keep) return;
      await gates.get(own_port)?.close();
      gates.delete(own_port);
      rmSync(scratch, { recursive: true, force: true });
    },
  };
  if (!state) await server.patch({ wind: { speed_m_per_s: 0 } });
  return server;
}

/** Without a window; WebGL by the software driver that comes with the browser. */
export function startBrowser() {
  const executablePath = process.env.CHROMIUM || "/usr/bin/chromium";
  return chromium.launch({
    executablePath,
    args: [
      "--headless",
      "--no-sandbox",
      "--disable-gpu",
      "--disable-quic",
      "--no-first-run",
      "--disable-background-networking",
      "--disable-component-update",
      "--disable-sync",
      "--disable-dev-shm-usage",
      "--disable-renderer-backgrounding",
      "--disable-backgrounding-occluded-windows",
      "--use-gl=angle",
      "--use-angle=swiftshader",
      "--enable-unsafe-swiftshader",
    ],
  });
}

/** Why there can be no test with a browser here; false where there can. */
export function whyNot() {
  return existsSync(process.env.CHROMIUM || "/usr/bin/chromium") ? false : "there is no Chromium (CHROMIUM names one)";
}

/**
 * A page that has shown frames. Errors on its console are collected.
 * @param {Browser} browser
 * @param {string} url
 * @param {import("playwright-core").BrowserContextOptions} [options]
 */
export async function openPage(browser, url, options = {}) {
  const context = await browser.newContext({ viewport: { width: 1000, height: 760 }, colorScheme: "dark", ...options });
  const page = await context.newPage();
  /** @type {string[]} */
  const errors = [];
  page.on("console", (message) => message.type() === "error" && errors.push(`${message.text()} ${message.location().url}`));
  page.on("pageerror", (error) => errors.push(error.message));
  await page.goto(url);
  return { context, page, errors };
}

/**
 * Waits until something holds in a page. Playwright's own waitForFunction evaluates text in the page, which its content policy
 * refuses, and rightly.
 * @template Argument
 * @param {Page} page
 * @param {string | ((argument: Argument) => unknown)} condition
 * @param {Argument} [argument]
 * @param {{ timeout?: number }} [options]
 */
export async function until(page, condition, argument, { timeout = 30_000 } = {}) {
  const until_ms = Date.now() + timeout;
  while (!(await page.evaluate(/** @type {any} */ (condition), argument))) {
    if (Date.now() > until_ms) throw new Error(`${timeout} ms have passed without ${condition}`);
    await new Promise((resolve) => setTimeout(resolve, 40));
  }
}

/** @param {Page} page */
export async function showsFrames(page) {
  await until(page, "window.skycell?.status.state === 'open' && window.skycell.counts.drawn > 0 && window.skycell.status.server !== null");
}

/** @param {Page} page */
export async function converged(page) {
  await until(page, "window.skycell.status.server?.sky_converged && window.skycell.status.fps < 0.6", undefined, { timeout: 60_000 });
}

/**
 * @param {Page} page
 * @param {string} name
 */
export async function screenshot(page, name) {
  mkdirSync(SCREENSHOTS, { recursive: true });
  await page.screenshot({ path: path.join(SCREENSHOTS, `${name}.png`) });
}

/**
 * What a canvas holds, as grey values of a grid of its places: for mean differences.
 * @param {Page} page
 * @param {string} selector
 * @returns {Promise<number[]>}
 */
export function pixelsOf(page, selector) {
  return page.evaluate((at) => {
    const canvas = /** @type {HTMLCanvasElement} */ (document.querySelector(at));
    const copy = new OffscreenCanvas(canvas.width, canvas.height);
    const context = /** @type {OffscreenCanvasRenderingContext2D} */ (copy.getContext("2d"));
    context.drawImage(canvas, 0, 0);
    const { data } = context.getImageData(0, 0, canvas.width, canvas.height);
    return [...data].filter((_, index) => index % 4 !== 3);
  }, selector);
}

/**
 * Mean absolute difference of 8-bit values.
 * @param {number[]} a
 * @param {number[]} b
 */
export function meanDifference(a, b) {
  if (a.length !== b.length) throw new Error(`${a.length} values against ${b.length}`);
  return a.reduce((sum, value, index) => sum + Math.abs(value - b[index]), 0) / a.length;
}
