// @ts-check
/**
 * The page: one connection, one picture, one look, and what stands around them.
 *
 * URL parameters: yaw, pitch, fov (degrees), width, height (pixels), fps, quality (a preset), codec
 * (jpeg or png; without: H.264 where the browser decodes it), show (a view's name), stereo
 * (how far two eyes are apart, metres), predict (off: frames are shown as they come). `/api/v1/views` lists the views.
 */

import { attachCellMap } from "./cell-map.js";
import { connect } from "./connection.js";
import { element, write } from "./dom.js";
import { showFigures } from "./figures.js";
import { attachGraph } from "./graph.js";
import { attachHelp, attachKeys } from "./keys.js";
import { attachLook, clamp, compassPoint } from "./look.js";
import { attachMaps } from "./maps.js";
import { PROTOCOL_MAX_SIZE, pictureSize } from "./picture-size.js";
import { attachScene } from "./scene.js";
import { attachSide } from "./side.js";
import { attachSkyControls } from "./sky-controls.js";
import { savePicture } from "./snapshot.js";
import { attachTheme } from "./theme.js";
import { connectionToken, sendTokens } from "./token.js";
import { createDecoder, supportedCodecs, takesScaledColours } from "./video-decoder.js";
import { createView } from "./view.js";
import { drawBar, fetchViews, tick } from "./views.js";
import { withMargin } from "./warp.js";

/** @typedef {import("./connection.js").ConnectionStatus} ConnectionStatus */
/** @typedef {import("./picture-size.js").SizeChoice} SizeChoice */
/** @typedef {import("./look.js").Camera} Camera */

const SETTLE_AFTER_RESIZE_MS = 200;
const DEFAULT_FPS = 30;
/** How much larger than shown a picture is asked for, so that there is something to turn to: 7.5 % beyond each edge. */
const MARGIN = 0.15;

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
const predict_box = element("predict", HTMLInputElement);

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

/** Why a video is not shown as one. */
let video_problem = "";
const decode = createDecoder({
  askForKeyFrame: () => connection.requestKeyFrame(),
  onGivenUp: (reason) => {
    video_problem = `This browser does not decode the video (${reason}); JPEG instead.`;
    connection.setView({ codec: "jpeg" });
  },
});
const asked_codec = query.get("codec");
/** @type {("jpeg" | "png" | "h264")[]} */
const codecs = asked_codec === "jpeg" || asked_codec === "png" ? [asked_codec] : await supportedCodecs();

const view = createView(canvas, decode);
predict_box.checked = view.canPredict() && query.get("predict") !== "off";
predict_box.disabled = !view.canPredict();
if (!view.canPredict()) write("predict-note", "This browser gives no WebGL2: frames are shown as they come.");

/** What is shown of a picture, and what is asked for. */
let shown = { width: 960, height: 540 };

/** Two eyes are not turned: what one sees is not a turn of what the other does. */
function predicts() {
  return predict_box.checked && !predict_box.disabled && wantedEyes() === null;
}

/**
 * The size of the picture to ask for; remembers what is shown of it.
 * @param {ConnectionStatus["welcome"]} welcome
 */
function askedSize(welcome) {
  const box = stage.getBoundingClientRect();
  const device_pixels = { width: box.width * devicePixelRatio, height: box.height * devicePixelRatio };
  shown = pictureSize(/** @type {SizeChoice} */ (size_chooser.value), device_pixels, welcome, wantedEyes() ? 2 : 1);
  const max = welcome ? { width: welcome.max_width, height: welcome.max_height } : PROTOCOL_MAX_SIZE;
  return predicts() ? withMargin(home, shown, MARGIN, max).size : shown;
}

/** @param {Camera} camera */
function askedCamera(camera) {
  const { welcome } = connection_status();
  const max = welcome ? { width: welcome.max_width, height: welcome.max_height } : PROTOCOL_MAX_SIZE;
  return predicts() ? withMargin(camera, shown, MARGIN, max).camera : camera;
}

/** @returns {{ welcome: ConnectionStatus["welcome"] }} */
let connection_status = () => ({ welcome: null });

const socket_url = new URL("ws", location.href);
socket_url.protocol = location.protocol === "https:" ? "wss:" : "ws:";
socket_url.search = "";
socket_url.hash = "";

const first_size = askedSize(null);
const connection = connect(socket_url, {
  view: {
    ...first_size,
    fps: parameter("fps", DEFAULT_FPS, 1, 120),
    codecs,
    scaled_colours: await takesScaledColours(),
    quality: wantedQuality(),
    stereo: wantedEyes(),
  },
  camera: askedCamera(home),
  token: connectionToken,
});
connection_status = () => connection.status;
connection.onFrame(view.show);
view.predict(predicts() ? shown : null);

const look = attachLook(canvas, {
  camera: home,
  pictureHeight: view.pictureHeight,
  onChange: (camera, at_ms) => {
    connection.setCamera(askedCamera(camera));
    view.look(camera, at_ms);
    showHeading();
  },
});
view.look(home, performance.now());

function applySize() {
  const { welcome } = connection.status;
  if (!welcome) return; // hello asked for a size that every server should afford
  const size = askedSize(welcome);
  const fps = Math.min(parameter("fps", DEFAULT_FPS, 1, 120), welcome.max_fps);
  connection.setView({ ...size, stereo: wantedEyes(), fps });
  connection.setCamera(askedCamera(look.camera()));
  view.predict(predicts() ? shown : null);
}
for (const box of [size_chooser, stereo_box, predict_box]) box.addEventListener("change", applySize);

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

function showHeading() {
  const { yaw_deg, pitch_deg, vertical_fov_deg } = look.camera();
  write(
    "heading",
    `${compassPoint(yaw_deg)} ${yaw_deg.toFixed(0)}° · ${pitch_deg < 0 ? "down" : "up"} ` +
      `${Math.abs(pitch_deg).toFixed(0)}° · field of view ${vertical_fov_deg.toFixed(0)}°`,
  );
}

const maps_button = element("maps-button", HTMLButtonElement);
attachMaps({
  panel: element("maps", HTMLElement),
  zones: element("map-zones", HTMLElement),
  told: element("map-told", HTMLElement),
  seconds: element("map-seconds", HTMLInputElement),
  opener: maps_button,
});

const cell_map_button = element("cell-map-button", HTMLButtonElement);
const cell_map = attachCellMap({
  panel: element("cell-map", HTMLElement),
  canvas: element("cell-map-canvas", HTMLCanvasElement),
  told: element("cell-map-told", HTMLElement),
  opener: cell_map_button,
  ownViewer: () => connection.status.welcome?.viewer ?? null,
});

const graph_button = element("graph-button", HTMLButtonElement);
const graph = attachGraph({
  panel: element("graph", HTMLElement),
  canvas: element("graph-canvas", HTMLCanvasElement),
  stages: element("stages", HTMLElement),
  opener: graph_button,
  motionMs: view.motionMs,
});

/** @type {ConnectionStatus["welcome"]} */
let last_welcome = null;
connection.onStatus((status) => {
  document.documentElement.dataset.state = status.state;
  write("state", status.message);
  write("countdown", status.retry_in_s === null ? "" : ` in ${status.retry_in_s} s`);
  write("problem", status.problem);
  showFigures(status, predicts() ? shown : null, view.motionMs(), video_problem);
  graph.add(status);
  if (status.welcome && status.welcome !== last_welcome) {
    const is_again = last_welcome !== null;
    last_welcome = status.welcome;
    write("adapter", status.welcome.adapter);
    applySize(); // now the limits are known
    if (is_again) scene.reload(); // it may have changed meanwhile
  }
});
showHeading();

const scene = attachScene({ onProblem: (text) => write("sky-problem", text), onDocument: () => controls?.showDay() });

/** @type {ReturnType<typeof attachSkyControls> | null} */
let controls = null;
controls = attachSkyControls(
  {
    preset: element("preset", HTMLSelectElement),
    gallery: element("gallery", HTMLElement),
    transition: element("transition", HTMLSelectElement),
    pause: element("pause", HTMLButtonElement),
    pace: element("pace", HTMLSelectElement),
    day: element("day", HTMLElement),
    hour: element("hour", HTMLInputElement),
    hour_text: element("hour-text", HTMLElement),
    marks: ["dawn", "noon", "dusk"].map((id) => element(id, HTMLButtonElement)),
    sky_time: element("sky-time", HTMLElement),
  },
  {
    onCamera: look.setCamera,
    onProblem: (text) => write("sky-problem", text),
    onPresets: scene.setPresets,
    onPreset: ({ name }) => scene.aboutToSet(name),
    onReport: ({ revision }) => scene.sawRevision(revision),
    onGap: scene.reload,
    onStep: scene.aboutToChange,
    latitude: scene.latitudeDeg,
  },
);

const side = attachSide({
  panel: element("side", HTMLElement),
  opener: element("side-button", HTMLButtonElement),
  closer: element("side-close", HTMLButtonElement),
  tabs: ["tab-sky", "tab-scene", "tab-view"].map((id) => element(id, HTMLElement)),
  onShown: (tab) => tab === "tab-scene" && scene.describe(),
});
const theme = attachTheme(element("theme-button", HTMLButtonElement));
const help = attachHelp(
  element("help-dialog", HTMLDialogElement),
  element("help-list", HTMLElement),
  element("help-button", HTMLButtonElement),
  element("help-close", HTMLButtonElement),
);

/** @type {string | null} */
let saved = null;
async function save() {
  try {
    saved = await savePicture(canvas);
  } catch (error) {
    write("sky-problem", error instanceof Error ? error.message : String(error));
  }
}
element("snapshot-button", HTMLButtonElement).addEventListener("click", save);

function toggleFull() {
  const change = document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen();
  change.catch(() => {}); // a browser, or an embedding page, that does not allow it
}
element("full-button", HTMLButtonElement).addEventListener("click", toggleFull);

attachKeys({
  p: side.toggle,
  m: () => maps_button.click(),
  c: () => cell_map_button.click(),
  l: () => graph_button.click(),
  " ": () => void controls?.togglePause(),
  s: save,
  f: toggleFull,
  h: () => document.documentElement.toggleAttribute("data-bare"),
  t: theme.next,
  "?": help.open,
  "ctrl+z": scene.undo,
});

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
    get motionMs() {
      return view.motionMs();
    },
    get cellMap() {
      return cell_map.shown();
    },
    get saved() {
      return saved;
    },
    connection,
    scene,
    look,
  }),
});
