// @ts-check
/**
 * Shows frames in a canvas: decodes one at a time, keeps only the newest, draws once per animation frame.
 */

import { unixMicros } from "./connection.js";

/** @typedef {import("./connection.js").Frame} Frame */

/**
 * @typedef {object} ViewCounts
 * @property {number} drawn
 * @property {number} dropped  overtaken by a newer frame before they were shown
 * @property {number} broken  not decodable
 */

/**
 * A hidden page has no animation frames, so it acknowledges nothing, and the server stops sending after two frames.
 *
 * @param {HTMLCanvasElement} canvas  shown with `object-fit: contain`
 * @returns {{ show: (frame: Frame) => void, pictureHeight: () => number, counts: () => ViewCounts }}
 */
export function createView(canvas) {
  const context = canvas.getContext("2d", { alpha: false });
  if (!context) throw new Error("this browser gives no 2D canvas");

  const counts = { drawn: 0, dropped: 0, broken: 0 };
  /** @type {Frame | null} */
  let undecoded = null;
  /** @type {{ frame: Frame, bitmap: ImageBitmap, decode_us: number } | null} */
  let undrawn = null;
  let decoding = false;
  let draw_scheduled = false;

  const draw = () => {
    draw_scheduled = false;
    if (!undrawn) return;
    const { frame, bitmap, decode_us } = undrawn;
    undrawn = null;
    // Setting a canvas' size clears it, even to the same size.
    if (canvas.width !== bitmap.width) canvas.width = bitmap.width;
    if (canvas.height !== bitmap.height) canvas.height = bitmap.height;
    context.drawImage(bitmap, 0, 0);
    bitmap.close();
    counts.drawn += 1;
    frame.presented({ decode_us, present_us: unixMicros() });
  };

  const decode = async (/** @type {Frame} */ frame) => {
    const started_ms = performance.now();
    const blob = new Blob([frame.payload], { type: `image/${frame.header.codec}` });
    const bitmap = await createImageBitmap(blob, { colorSpaceConversion: "none" });
    if (undrawn) {
      undrawn.bitmap.close();
      counts.dropped += 1;
    }
    undrawn = { frame, bitmap, decode_us: (performance.now() - started_ms) * 1000 };
    if (!draw_scheduled) {
      draw_scheduled = true;
      requestAnimationFrame(draw);
    }
  };

  const pump = async () => {
    if (decoding) return;
    decoding = true;
    while (undecoded) {
      const frame = undecoded;
      undecoded = null;
      try {
        await decode(frame);
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
      if (undecoded) counts.dropped += 1;
      undecoded = frame;
      void pump();
    },
    pictureHeight() {
      const box = canvas.getBoundingClientRect();
      const scale = Math.min(box.width / canvas.width, box.height / canvas.height);
      return canvas.height * scale;
    },
    counts: () => ({ ...counts }),
  };
}
