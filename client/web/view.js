// @ts-check
/**
 * Shows frames in a canvas: decodes one at a time, keeps only the newest, draws once per animation frame. Of a video every
 * frame is decoded. Between frames it turns the last one to the newest camera, where it is told to.
 */

import { unixMicros } from "./connection.js";
import { decodeImage } from "./video-decoder.js";
import { createPainter, warpBetween } from "./warp.js";

/** @typedef {import("./connection.js").Frame} Frame */
/** @typedef {import("./look.js").Camera} Camera */
/** @typedef {import("./warp.js").Size} Size */
/** @typedef {import("./video-decoder.js").Decoded} Decoded */

/**
 * @typedef {object} ViewCounts
 * @property {number} drawn  frames
 * @property {number} turned  pictures between frames, turned to a newer camera
 * @property {number} dropped  overtaken by a newer frame before they were shown
 * @property {number} broken  not decodable
 */

/**
 * @typedef {object} SkyView
 * @property {(frame: Frame) => void} show
 * @property {(camera: Camera, at_ms: number) => void} look  the newest camera, and when it was asked for (performance.now())
 * @property {(size: Size | null) => void} predict  turns pictures to the newest camera and shows them at this size; null:
 *   shows frames as they come
 * @property {() => boolean} canPredict
 * @property {() => number} pictureHeight  as it is shown, CSS pixels
 * @property {() => number | null} motionMs  from a movement of the hand until the picture that shows it was drawn, smoothed
 * @property {() => ViewCounts} counts
 */

/**
 * A hidden page has no animation frames, so it acknowledges nothing, and the server stops sending after two frames.
 *
 * @param {HTMLCanvasElement} canvas  shown with `object-fit: contain`
 * @param {(frame: Frame) => Promise<Decoded>} [decode]
 * @returns {SkyView}
 */
export function createView(canvas, decode = decodeImage) {
  const painter = createPainter(canvas);
  const counts = { drawn: 0, turned: 0, dropped: 0, broken: 0 };
  /** @type {Frame[]} */
  let undecoded = [];
  /** @type {{ frame: Frame, decoded: Decoded, decode_us: number } | null} */
  let undrawn = null;
  /** What the painter holds. @type {{ camera: Camera | null, input: number, size: Size, stereo: boolean } | null} */
  let shot = null;
  /** @type {Camera | null} */
  let newest = null;
  /** @type {Size | null} */
  let predicted_size = null;
  /** When the hand moved, of a movement that no picture shows yet. @type {number | null} */
  let moved_ms = null;
  /** @type {number | null} */
  let motion_ms = null;
  let decoding = false;
  let draw_scheduled = false;

  /** @param {number} at_ms */
  const measureMotion = (at_ms) => {
    const took_ms = performance.now() - at_ms;
    motion_ms = motion_ms === null ? took_ms : motion_ms + 0.3 * (took_ms - motion_ms);
  };

  /** Whether it shows the newest camera. */
  const paint = () => {
    if (!shot) return false;
    const { camera, size, stereo } = shot;
    // Another place is another sky: that is not made by turning.
    const turns =
      painter.kind === "webgl2" &&
      predicted_size !== null &&
      !stereo &&
      camera !== null &&
      newest !== null &&
      newest.position_m.every((at_m, axis) => at_m === camera.position_m[axis]);
    if (turns) painter.paint(predicted_size ?? size, warpBetween(camera, size, newest ?? camera, predicted_size ?? size));
    else painter.paint(size, null);
    return turns;
  };

  const draw = () => {
    draw_scheduled = false;
    const frame = undrawn?.frame ?? null;
    const decode_us = undrawn?.decode_us ?? 0;
    if (undrawn) {
      const { decoded } = undrawn;
      undrawn = null;
      const size = { width: decoded.width, height: decoded.height };
      painter.load(decoded.picture, size);
      decoded.picture.close();
      shot = { camera: frame?.camera ?? null, input: frame?.header.input ?? 0, size, stereo: frame?.header.stereo ?? false };
    }
    const shows_newest = paint();
    if (frame) counts.drawn += 1;
    else counts.turned += 1;
    frame?.presented({ decode_us, present_us: unixMicros() });
    if (moved_ms !== null && (shows_newest || (frame?.camera && sameLook(frame.camera, newest)))) {
      measureMotion(moved_ms);
      moved_ms = null;
    }
  };

  const schedule = () => {
    if (draw_scheduled) return;
    draw_scheduled = true;
    requestAnimationFrame(draw);
  };

  const pump = async () => {
    if (decoding) return;
    decoding = true;
    for (let frame = undecoded.shift(); frame; frame = undecoded.shift()) {
      try {
        const started_ms = performance.now();
        const decoded = await decode(frame);
        if (undrawn) {
          undrawn.decoded.picture.close();
          counts.dropped += 1;
        }
        undrawn = { frame, decoded, decode_us: (performance.now() - started_ms) * 1000 };
        schedule();
      } catch {
        counts.broken += 1;
        // Unshown, yet acknowledged: the next one may be whole.
        frame.presented({ decode_us: 0, present_us: unixMicros() });
      }
    }
    decoding = false;
  };

  return {
    show(frame) {
      // What comes later builds on the frames of a video; the server has at most two under way.
      const needed = undecoded.filter(({ header }) => header.codec === "h264");
      counts.dropped += undecoded.length - needed.length;
      undecoded = [...needed, frame];
      void pump();
    },
    look(camera, at_ms) {
      newest = camera;
      if (shot) moved_ms ??= at_ms;
      if (predicted_size && shot) schedule();
    },
    predict(size) {
      predicted_size = painter.kind === "webgl2" ? size : null;
      if (shot) schedule();
    },
    canPredict: () => painter.kind === "webgl2",
    pictureHeight() {
      const box = canvas.getBoundingClientRect();
      const scale = Math.min(box.width / canvas.width, box.height / canvas.height);
      return canvas.height * scale;
    },
    motionMs: () => motion_ms,
    counts: () => ({ ...counts }),
  };
}

/**
 * @param {Camera} a
 * @param {Camera | null} b
 */
function sameLook(a, b) {
  return b !== null && Math.abs(a.yaw_deg - b.yaw_deg) < 1e-9 && Math.abs(a.pitch_deg - b.pitch_deg) < 1e-9;
}
