// @ts-check
/**
 * How large a picture to ask for.
 *
 * @typedef {{ width: number, height: number }} Size
 * @typedef {"auto" | "fit" | `${number}x${number}`} SizeChoice
 */

/** What the protocol allows at most; a server may allow less and says so in its welcome. */
export const PROTOCOL_MAX_SIZE = Object.freeze({ width: 3840, height: 2160 });

/** A software driver on two cores keeps up with about this many pixels. */
const SOFTWARE_PIXELS = 960 * 540;
const SMALLEST = 16;
/** Columns of a block of a JPEG with chroma at half the size. */
const BLOCK = 16;

/**
 * Whether the name of an adapter is that of a driver that renders on the CPU.
 * @param {string} adapter
 */
export function isSoftwareAdapter(adapter) {
  return /llvmpipe|lavapipe|swiftshader|software|\bcpu\b|\bwarp\b|basic render/i.test(adapter);
}

/**
 * The size of one eye's picture to ask for, even in both directions (chroma is stored at half the size), the stage's aspect kept.
 *
 * @param {SizeChoice} choice  "fit": every pixel of the stage; "auto": the same, but fewer on a software adapter
 * @param {Size} stage  device pixels
 * @param {{ adapter: string, max_width: number, max_height: number } | null} welcome  null before it came
 * @param {1 | 2} [eyes]  side by side in the stage and in a frame
 * @returns {Size}
 */
export function pictureSize(choice, stage, welcome, eyes = 1) {
  const whole = welcome ? { width: welcome.max_width, height: welcome.max_height } : PROTOCOL_MAX_SIZE;
  const max = { width: Math.floor(whole.width / eyes), height: whole.height };
  const fixed = /^(\d+)x(\d+)$/.exec(choice);
  const wish = fixed ? { width: Number(fixed[1]), height: Number(fixed[2]) } : { width: stage.width / eyes, height: stage.height };
  let scale = Math.min(1, max.width / wish.width, max.height / wish.height);
  if (choice === "auto" && (!welcome || isSoftwareAdapter(welcome.adapter))) {
    scale = Math.min(scale, Math.sqrt(SOFTWARE_PIXELS / (eyes * wish.width * wish.height)));
  }
  const rounded = (/** @type {number} */ pixels, /** @type {number} */ limit, /** @type {number} */ step) =>
    Math.min(limit, Math.max(SMALLEST, step * Math.round((pixels * scale) / step)));
  // No block of a JPEG lies across both eyes.
  const columns = eyes === 2 && !fixed ? BLOCK : 2;
  return { width: rounded(wish.width, max.width, columns), height: rounded(wish.height, max.height, 2) };
}
