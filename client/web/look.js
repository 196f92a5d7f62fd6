// @ts-check
/**
 * Looking around: how pointers, wheel and keys turn a camera. The first half is pure and tested in `tests/`.
 * Conventions: yaw 0 looks north and grows clockwise, pitch grows upwards, degrees.
 *
 * @typedef {object} Camera
 * @property {[number, number, number]} position_m  x east, y up, z south
 * @property {number} yaw_deg
 * @property {number} pitch_deg
 * @property {number} vertical_fov_deg
 */

/** What a hand can reach; the protocol allows 1 to 170. */
export const FOV_LIMITS_DEG = Object.freeze({ min: 3, max: 120 });
const PITCH_LIMIT_DEG = 90;
/** One notch of a wheel (100 units) changes the picture's scale by about 13 %. Tuned by hand. */
const ZOOM_PER_WHEEL_UNIT = 0.0012;
/** A key press turns by this share of the field of view, so that it feels the same at every zoom. */
const KEY_TURN_SHARE = 1 / 12;
const KEY_ZOOM_FACTOR = 1.15;
/** A wheel may count in pixels, lines or pages (WheelEvent.deltaMode). */
const PIXELS_PER_WHEEL_MODE = [1, 33, 400];

const DEG = Math.PI / 180;

/**
 * @param {number} value
 * @param {number} low
 * @param {number} high
 */
export function clamp(value, low, high) {
  return Math.min(high, Math.max(low, value));
}

/**
 * The same direction with a yaw of at least 0 and below 360.
 * @param {number} yaw_deg
 */
export function wrapYaw(yaw_deg) {
  const wrapped = yaw_deg % 360;
  return wrapped < 0 ? (wrapped + 360) % 360 : wrapped;
}

/**
 * The camera after the picture was dragged: what was under the pointer stays under it (exactly so in the middle).
 *
 * @param {Camera} camera
 * @param {number} dx_px  to the right
 * @param {number} dy_px  downwards
 * @param {number} picture_height_px  of the picture as it is shown, in the same pixels
 * @returns {Camera}
 */
export function dragged(camera, dx_px, dy_px, picture_height_px) {
  const focal_px = Math.max(1, picture_height_px) / 2 / Math.tan((camera.vertical_fov_deg / 2) * DEG);
  // A circle of yaw shrinks with the cosine of the pitch; bounded so that looking straight up does not spin.
  const yaw_scale = 1 / Math.max(0.2, Math.cos(camera.pitch_deg * DEG));
  return {
    ...camera,
    yaw_deg: wrapYaw(camera.yaw_deg - (Math.atan(dx_px / focal_px) / DEG) * yaw_scale),
    pitch_deg: clamp(camera.pitch_deg + Math.atan(dy_px / focal_px) / DEG, -PITCH_LIMIT_DEG, PITCH_LIMIT_DEG),
  };
}

/**
 * The camera with its picture scaled, as if the paper were held closer.
 *
 * @param {Camera} camera
 * @param {number} scale  above 1 shows less sky, larger
 * @returns {Camera}
 */
export function zoomed(camera, scale) {
  const half_tan = Math.tan((camera.vertical_fov_deg / 2) * DEG) / scale;
  const fov_deg = (2 * Math.atan(half_tan)) / DEG;
  return { ...camera, vertical_fov_deg: clamp(fov_deg, FOV_LIMITS_DEG.min, FOV_LIMITS_DEG.max) };
}

/**
 * The camera after a key, or null where the key means nothing here.
 *
 * @param {Camera} camera
 * @param {string} key  KeyboardEvent.key
 * @param {Camera} home  where the key Home leads
 * @returns {Camera | null}
 */
export function keyed(camera, key, home) {
  const turn_deg = camera.vertical_fov_deg * KEY_TURN_SHARE;
  const turned = (/** @type {number} */ yaw_deg, /** @type {number} */ pitch_deg) => ({
    ...camera,
    yaw_deg: wrapYaw(camera.yaw_deg + yaw_deg),
    pitch_deg: clamp(camera.pitch_deg + pitch_deg, -PITCH_LIMIT_DEG, PITCH_LIMIT_DEG),
  });
  switch (key) {
    case "ArrowLeft":
      return turned(-turn_deg, 0);
    case "ArrowRight":
      return turned(turn_deg, 0);
    case "ArrowUp":
      return turned(0, turn_deg);
    case "ArrowDown":
      return turned(0, -turn_deg);
    case "+":
    case "=":
      return zoomed(camera, KEY_ZOOM_FACTOR);
    case "-":
      return zoomed(camera, 1 / KEY_ZOOM_FACTOR);
    case "Home":
      return { ...home };
    default:
      return null;
  }
}

/**
 * "N", "NE" …: for people.
 * @param {number} yaw_deg
 */
export function compassPoint(yaw_deg) {
  return ["N", "NE", "E", "SE", "S", "SW", "W", "NW"][Math.round(wrapYaw(yaw_deg) / 45) % 8];
}

/**
 * Turns a camera by what happens on an element: drag, pinch, wheel, arrow keys.
 *
 * @param {HTMLElement} element  wants `touch-action: none` and a tabindex
 * @param {object} options
 * @param {Camera} options.camera  where to start; also where the key Home leads
 * @param {() => number} options.pictureHeight  height of the picture as shown, CSS pixels
 * @param {(camera: Camera, at_ms: number) => void} options.onChange  at_ms: when the hand moved, by performance.now()
 * @returns {{ camera: () => Camera, setCamera: (camera: Camera) => void, stop: () => void }}
 */
export function attachLook(element, { camera: home, pictureHeight, onChange }) {
  let camera = { ...home };
  /** @type {Map<number, { x: number, y: number }>} */
  const pointers = new Map();
  const listeners = new AbortController();
  const { signal } = listeners;

  const change = (/** @type {Camera} */ next, at_ms = performance.now()) => {
    camera = next;
    onChange(camera, at_ms);
  };

  /** Distance of the first two fingers; 0 without two. */
  const spread = () => {
    const [a, b] = [...pointers.values()];
    return a && b ? Math.hypot(a.x - b.x, a.y - b.y) : 0;
  };

  element.addEventListener(
    "pointerdown",
    (event) => {
      if (event.button !== 0) return;
      element.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      element.classList.add("dragging");
    },
    { signal },
  );
  element.addEventListener(
    "pointermove",
    (event) => {
      const before = pointers.get(event.pointerId);
      if (!before) return;
      const spread_before = spread();
      const now = { x: event.clientX, y: event.clientY };
      pointers.set(event.pointerId, now);
      // With two fingers each moves the middle by half of its way.
      const share = 1 / pointers.size;
      let next = dragged(camera, (now.x - before.x) * share, (now.y - before.y) * share, pictureHeight());
      if (spread_before > 0) next = zoomed(next, clamp(spread() / spread_before, 0.5, 2));
      change(next, event.timeStamp);
    },
    { signal },
  );
  const release = (/** @type {PointerEvent} */ event) => {
    pointers.delete(event.pointerId);
    if (pointers.size === 0) element.classList.remove("dragging");
  };
  element.addEventListener("pointerup", release, { signal });
  element.addEventListener("pointercancel", release, { signal });
  element.addEventListener("lostpointercapture", release, { signal });
  element.addEventListener(
    "wheel",
    (event) => {
      event.preventDefault();
      const pixels = event.deltaY * (PIXELS_PER_WHEEL_MODE[event.deltaMode] ?? 1);
      change(zoomed(camera, Math.exp(-clamp(pixels, -600, 600) * ZOOM_PER_WHEEL_UNIT)), event.timeStamp);
    },
    { signal, passive: false },
  );
  element.addEventListener(
    "keydown",
    (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const next = keyed(camera, event.key, home);
      if (!next) return;
      event.preventDefault();
      change(next, event.timeStamp);
    },
    { signal },
  );

  return { camera: () => ({ ...camera }), setCamera: (next) => change({ ...next }), stop: () => listeners.abort() };
}
