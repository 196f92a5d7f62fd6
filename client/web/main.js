// @ts-check
/**
 * The page: one connection, one picture, one look, and a status line.
 *
 * URL parameters: yaw, pitch, fov (degrees), width, height (pixels), fps, quality (a preset), show (a view's name), stereo
 * (how far two eyes are apart, metres). `/api/v1/views` lists the views.
 */

import { attachCellMap } from "./cell-map.js";
import { connect } from "./connection.js";
import { attachMaps } from "./maps.js";
import { attachLook, clamp, compassPoint } from "./look.js";
import { pictureSize } from "./picture-size.js";
import { attachSkyControls } from "./sky-controls.js";
import { connectionToken, sendTokens } from "./token.js";
import { createView } from "./view.js";
import { drawBar, fetchViews, tick } from "./views.js";

/** @typedef {import("./connection.js").ConnectionStatus} ConnectionStatus */
/** @typedef {import("./picture-size.js").SizeChoice} SizeChoice */

const SETTLE_AFTER_RESIZE_MS = 200;
const DEFAULT_FPS = 30;

/**
 * @template {HTMLElement} T
 * @param {string} id
 * @param {new () => T} type
 * @returns {T}
 */
function element(id, type) {
  const found = document.getElementById(id);
  if (!(found instanceof type)) throw new Error(`the page has no #${id}`);
  return found;
}

sendTokens();

const query = new URLSearchParams(location.search);

/**
 * A number of the address, or the fallback where it is missing or no number.
 * @param {string} name
 * @param {number} fallback
 * @param {number} low
 * @param {number} high
 */
function parameter(name, fallback, low, high) {
  const text = query.get(name);
  const value = text === null || text.trim() === "" ? Number.NaN : Number(text);
  return Number.isFinite(value) ? clamp(value, low, high) : fallback;
}

const canvas = element("picture", HTMLCanvasElement);
const stage = element("stage", HTMLElement);
const size_chooser = element("size", HTMLSelectElement);
const quality_chooser = element("quality", HTMLSelectElement);
const show_chooser = element("show", HTMLSelectElement);
const stereo_box = element("stereo", HTMLInputElement);

const home = {
  position_m: /** @type {[number, number, number]} */ ([0, 2, 0]),
  yaw_deg: parameter("yaw", 0, -1e6, 1e6),
  pitch_deg: parameter("pitch", 12, -90, 90),
  vertical_fov_deg: parameter("fov", 60, 1, 170),
};

if (query.has("width") || query.has("height")) {
  const width = Math.round(parameter("width", 960, 1, 3840));
  const height = Math.round(parameter("height", 540, 1, 2160));
  const choice = `${width}x${height}`;
  if (![...size_chooser.options].some(({ value }) => value === choice)) {
    size_chooser.add(new Option(`${width} × ${height}`, choice));
  }
  size_chooser.value = choice;
}

const asked_quality = query.get("quality") ?? "";
if ([...quality_chooser.options].some(({ value }) => value === asked_quality)) quality_chooser.value = asked_quality;

/** @returns {import("./connection.js").Quality | null} */
function wantedQuality() {
  const preset = quality_chooser.value;
  return preset === "" ? null : { preset: /** @type {"draft" | "balanced" | "high" | "reference"} */ (preset) };
}

/** Of people. */
const EYE_DISTANCE_M = 0.064;
const pair = { eye_distance_m: parameter("stereo", EYE_DISTANCE_M, 0, 100) };
stereo_box.checked = query.has("stereo");

/** @returns {import("./connection.js").Stereo | null} */
function wantedEyes() {
  return stereo_box.checked ? pair : null;
}

/** @param {ConnectionStatus["welcome"]} welcome */
function wantedSize(welcome) {
  const box = stage.getBoundingClientRect();
  const device_pixels = { width: box.width * devicePixelRatio, height: box.height * devicePixelRatio };
  return pictureSize(/** @type {SizeChoice} */ (size_chooser.value), device_pixels, welcome, wantedEyes() ? 2 : 1);
}

const socket_url = new URL("ws", location.href);
socket_url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
socket_url.search = "";
socket_url.hash = "";

const view = createView(canvas);
const connection = connect(socket_url, {
  view: {
    ...wantedSize(null),
    fps: parameter("fps", DEFAULT_FPS, 1, 120),
    codec: "jpeg",
    quality: wantedQuality(),
    stereo: wantedEyes(),
  },
  camera: home,
  token: connectionToken,
});
connection.onFrame(view.show);

const look = attachLook(canvas, {
  camera: home,
  pictureHeight: view.pictureHeight,
  onChange: (camera) => {
    connection.setCamera(camera);
    showHeading();
  },
});

attachMaps({
  panel: element("maps", HTMLElement),
  zones: element("map-zones", HTMLElement),
  told: element("map-told", HTMLElement),
  seconds: element("map-seconds", HTMLInputElement),
  opener: element("maps-button", HTMLButtonElement),
});

const cell_map = attachCellMap({
  panel: element("cell-map", HTMLElement),
  canvas: element("cell-map-canvas", HTMLCanvasElement),
  told: element("cell-map-told", HTMLElement),
  opener: element("cell-map-button", HTMLButtonElement),
  ownViewer: () => connection.status.welcome?.viewer ?? null,
});

function applySize() {
  const { welcome } = connection.status;
  if (!welcome) return; // hello asked for a size that every server should afford
  const stereo = wantedEyes();
  const fps = Math.min(parameter("fps", DEFAULT_FPS, 1, 120), welcome.max_fps);
  connection.setView({ ...wantedSize(welcome), stereo, fps });
}
size_chooser.addEventListener("change", applySize);
stereo_box.addEventListener("change", applySize);
/** @type {import("./views.js").ShowReport[]} */
let known_views = [];

function applyShow() {
  const name = show_chooser.value;
  connection.setView({ show: name });
  const scale = known_views.find((known) => known.name === name)?.scale ?? null;
  element("legend", HTMLElement).hidden = scale === null;
  if (scale) {
    write("legend-low", tick(scale, 0));
    write("legend-middle", `, in the middle ${tick(scale, 0.5)}, `);
    write("legend-high", tick(scale, 1));
  }
}
show_chooser.addEventListener("change", applyShow);
drawBar(element("legend-bar", HTMLCanvasElement));
void fetchViews().then((views) => {
  known_views = views;
  show_chooser.replaceChildren(...views.map(({ name, label }) => new Option(`${name}: ${label}`, name)));
  if (views.length === 0) show_chooser.add(new Option("the sky", "picture"));
  const asked = query.get("show") ?? "picture";
  show_chooser.value = views.some(({ name }) => name === asked) ? asked : "picture";
  if (show_chooser.value !== "picture") applyShow();
});
quality_chooser.addEventListener("change", () => connection.setView({ quality: wantedQuality() }));
/** @type {ReturnType<typeof setTimeout> | undefined} */
let resize_timer;
new ResizeObserver(() => {
  clearTimeout(resize_timer);
  resize_timer = setTimeout(applySize, SETTLE_AFTER_RESIZE_MS);
}).observe(stage);

const grouped = new Intl.NumberFormat("en", { useGrouping: true });

/**
 * Writes only what changed, so that nothing is laid out or read aloud again for nothing.
 * @param {string} id
 * @param {string} text
 */
function write(id, text) {
  const target = element(id, HTMLElement);
  if (target.textContent !== text) target.textContent = text;
}

function showHeading() {
  const { yaw_deg, pitch_deg, vertical_fov_deg } = look.camera();
  write(
    "heading",
    `${compassPoint(yaw_deg)} ${yaw_deg.toFixed(0)}° · ${pitch_deg < 0 ? "down" : "up"} ` +
      `${Math.abs(pitch_deg).toFixed(0)}° · field of view ${vertical_fov_deg.toFixed(0)}°`,
  );
}

/** @param {import("./connection.js").ServerStatus} server */
function texelsText({ texels_pending, sky_converged }) {
  if (texels_pending > 0) return `${grouped.format(texels_pending)} pending`;
  return sky_converged ? "converged" : "none pending";
}

/** @param {import("./connection.js").ServerStatus} server */
function cacheErrorText({ cache_error_p50_percent: p50, cache_error_p95_percent: p95 }) {
  if (typeof p50 !== "number" || typeof p95 !== "number") return "–";
  return `p50 ${p50.toFixed(1)} % p95 ${p95.toFixed(1)} %`;
}

/** @param {import("./connection.js").ServerStatus} server */
function pickedText({ quality }) {
  if (!quality) return "–";
  const flip = `FLIP ${quality.measured ? "" : "about "}${quality.flip.toFixed(3)}`;
  const time = typeof quality.device_ms === "number" ? ` · ${quality.device_ms.toFixed(1)} ms` : "";
  return `${quality.name} · ${flip}${time}${quality.is_met ? "" : " · not as asked"}`;
}

/** @param {ConnectionStatus} status */
function showFigures(status) {
  const { server, header, fps, mbit_per_s, latency_ms, frame_age_ms } = status;
  const at_rest = status.state === "open" && fps === 0 && header !== null;
  write("fps", at_rest ? "at rest" : fps.toFixed(fps < 9.95 ? 1 : 0));
  write("rate", `${mbit_per_s.toFixed(mbit_per_s < 9.95 ? 2 : 1)} Mbit/s`);
  write("latency", latency_ms === null ? "–" : `${latency_ms.toFixed(0)} ms`);
  // By two clocks: an age below zero or of minutes says that they differ, not how old the frame is.
  const age_known = frame_age_ms !== null && frame_age_ms >= 0 && frame_age_ms < 60_000;
  write("age", age_known ? `${frame_age_ms.toFixed(0)} ms` : "–");
  write("cell", server && server.cell !== null ? server.cell_name || `cell ${server.cell}` : "–");
  write("viewers", server ? String(server.viewers_in_cell) : "–");
  write("overlap", server ? `${(server.overlap * 100).toFixed(0)} %` : "–");
  write("texels", server ? texelsText(server) : "–");
  write("picked", server ? pickedText(server) : "–");
  write("cache-error", server ? cacheErrorText(server) : "–");
  write("renderer", server?.renderer ?? "–");
  const notes = [server?.show_note ?? server?.renderer_note, server?.loss_note];
  write("show-note", notes.filter((note) => note).join("; "));
  write("picture-size", header ? sizeText(header) : "–");
}

/** @param {import("./connection.js").FrameHeader} header */
function sizeText({ width, height, stereo, coarse }) {
  const size = stereo ? `2 × ${width / 2} × ${height}` : `${width} × ${height}`;
  return coarse ? `${size}, still coarse` : size;
}

/** @type {ConnectionStatus["welcome"]} */
let last_welcome = null;
connection.onStatus((status) => {
  document.documentElement.dataset.state = status.state;
  write("state", status.message);
  write("countdown", status.retry_in_s === null ? "" : ` in ${status.retry_in_s} s`);
  write("problem", status.problem);
  showFigures(status);
  if (status.welcome && status.welcome !== last_welcome) {
    last_welcome = status.welcome;
    write("adapter", status.welcome.adapter);
    applySize(); // now the limits are known
  }
});
showHeading();

attachSkyControls(
  {
    preset: element("preset", HTMLSelectElement),
    transition: element("transition", HTMLSelectElement),
    pause: element("pause", HTMLButtonElement),
    pace: element("pace", HTMLSelectElement),
    hour: element("hour", HTMLInputElement),
    hour_text: element("hour-text", HTMLElement),
    sky_time: element("sky-time", HTMLElement),
  },
  {
    onCamera: look.setCamera,
    onProblem: (text) => write("sky-problem", text),
  },
);

// For tests and the console.
Object.defineProperty(window, "skycell", {
  value: Object.freeze({
    get status() {
      return connection.status;
    },
    get camera() {
      return look.camera();
    },
    get counts() {
      return view.counts();
    },
    get cellMap() {
      return cell_map.shown();
    },
    connection,
  }),
});
