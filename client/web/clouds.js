// @ts-check
/**
 * Clouds alone, for a renderer of your own: reads the payload of frames whose codec is "clouds". Needs no page. The format's
 * home is `protocol/src/clouds.rs`, which tells what each number means and how exact it is.
 *
 *     const connection = connect(url, { view: { width: 960, height: 540, fps: 30, codec: "clouds" }, camera });
 *     connection.onFrame(async (frame) => {
 *       const clouds = await parseClouds(frame.payload);
 *       upload(clouds); // then background * transmittance + colour / pre_exposure
 *       frame.presented({ decode_us, present_us });
 *     });
 */

/**
 * @typedef {object} Clouds
 * @property {number} width  pixels, of both eyes together where there are two
 * @property {number} height
 * @property {number} pre_exposure  what colour was multiplied by, a power of two
 * @property {boolean} haze  colour includes the haze in front of the clouds
 * @property {Uint16Array[]} planes  bits of half floats, rows from top to bottom: red, green and blue (premultiplied, linear),
 *   transmittance, mean distance in km (0 where there are no clouds)
 */

/** Bytes before the zlib stream. */
export const CLOUDS_HEADER_BYTES = 32;

const VERSION = 1;
const PLANES = 5;
const RED = 0;
const GREEN = 1;
const BLUE = 2;
const TRANSMITTANCE = 3;
const DISTANCE = 4;
const FLAG_HAZE = 1;
const WIDTH_MAX = 3840;
const HEIGHT_MAX = 2160;
const HALF_ONE = 0x3c00;
const HALF_MAX = 0x7bff;

/** A payload that does not follow the protocol. */
export class CloudsError extends Error {
  name = "CloudsError";
}

/**
 * Reads a payload.
 *
 * @param {Uint8Array<ArrayBuffer>} payload
 * @returns {Promise<Clouds>}
 * @throws {CloudsError} says what is wrong; takes no more memory than the size that the payload tells needs
 */
export async function parseClouds(payload) {
  if (payload.length < CLOUDS_HEADER_BYTES) {
    throw new CloudsError(`clouds have at least ${CLOUDS_HEADER_BYTES} bytes, these have ${payload.length}`);
  }
  const view = new DataView(payload.buffer, payload.byteOffset, CLOUDS_HEADER_BYTES);
  if (view.getUint8(0) !== VERSION) throw new CloudsError(`version ${view.getUint8(0)} of clouds is not known here`);
  if (view.getUint8(1) !== PLANES) throw new CloudsError(`clouds of ${view.getUint8(1)} planes instead of ${PLANES}`);
  const flags = view.getUint16(2, true);
  const later = payload.subarray(20, CLOUDS_HEADER_BYTES);
  if ((flags & ~FLAG_HAZE) !== 0 || later.some((byte) => byte !== 0)) {
    throw new CloudsError("flags or reserved bytes of clouds are set that are not known here");
  }
  const width = sizeWithin("width", view.getUint32(4, true), WIDTH_MAX);
  const height = sizeWithin("height", view.getUint32(8, true), HEIGHT_MAX);
  const pre_exposure = view.getFloat32(12, true);
  const fraction = view.getUint32(12, true) & 0x7fffff;
  if (!(pre_exposure >= 2 ** -126 && pre_exposure < Infinity) || fraction !== 0) {
    throw new CloudsError(`pre_exposure of clouds is ${pre_exposure}; allowed: positive powers of two`);
  }
  const data = payload.subarray(CLOUDS_HEADER_BYTES);
  const data_bytes = view.getUint32(16, true);
  if (data.length !== data_bytes) {
    throw new CloudsError(`clouds announce ${data_bytes} bytes of data and ${data.length} follow`);
  }
  const pixels = width * height;
  const bytes = await inflated(data, 2 * PLANES * pixels);
  const planes = Array.from({ length: PLANES }, (_, plane) => {
    const at = 2 * plane * pixels;
    return unfolded(bytes.subarray(at, at + pixels), bytes.subarray(at + pixels, at + 2 * pixels));
  });
  for (const plane of [RED, BLUE]) {
    for (let at = 0; at < pixels; at += 1) planes[plane][at] += planes[GREEN][at];
  }
  for (const plane of planes) restore(plane, width);
  planes.forEach((plane, index) => {
    const most = index === TRANSMITTANCE ? HALF_ONE : HALF_MAX;
    const pixel = plane.findIndex((bits) => bits > most);
    if (pixel >= 0) throw new CloudsError(`plane ${index} of clouds holds ${floatOfHalf(plane[pixel])} at pixel ${pixel}`);
  });
  return { width, height, pre_exposure, haze: (flags & FLAG_HAZE) !== 0, planes };
}

/**
 * Radiance without pre-exposure and transmittance: four floats a pixel, as a texture of premultiplied colour has them but for the
 * last, which is 1 - alpha.
 *
 * @param {Clouds} clouds
 * @returns {Float32Array<ArrayBuffer>}
 */
export function floatsOfClouds({ planes, pre_exposure }) {
  const floats = new Float32Array(4 * planes[0].length);
  for (let channel = 0; channel < 4; channel += 1) {
    const scale = channel === TRANSMITTANCE ? 1 : 1 / pre_exposure;
    const plane = planes[channel];
    for (let pixel = 0; pixel < plane.length; pixel += 1) floats[4 * pixel + channel] = floatOfHalf(plane[pixel]) * scale;
  }
  return floats;
}

/**
 * Mean distances along the rays, m; 0 where there are no clouds.
 *
 * @param {Clouds} clouds
 * @returns {Float32Array<ArrayBuffer>}
 */
export function distancesOfClouds({ planes }) {
  return Float32Array.from(planes[DISTANCE], (bits) => 1000 * floatOfHalf(bits));
}

/** @param {number} bits  of a half float */
export function floatOfHalf(bits) {
  const exponent = (bits >> 10) & 0x1f;
  const fraction = bits & 0x3ff;
  const sign = bits & 0x8000 ? -1 : 1;
  if (exponent === 0) return sign * fraction * 2 ** -24;
  if (exponent === 0x1f) return fraction ? NaN : sign * Infinity;
  return sign * (1024 + fraction) * 2 ** (exponent - 25);
}

/**
 * @param {string} name
 * @param {number} value
 * @param {number} max
 */
function sizeWithin(name, value, max) {
  if (value < 1 || value > max) throw new CloudsError(`${name} of clouds is ${value}; allowed: 1 to ${max}`);
  return value;
}

/**
 * @param {Uint8Array<ArrayBuffer>} data  a zlib stream
 * @param {number} expected  what comes out of it, bytes
 */
async function inflated(data, expected) {
  const reader = new Blob([data]).stream().pipeThrough(new DecompressionStream("deflate")).getReader();
  const bytes = new Uint8Array(expected);
  let found = 0;
  for (;;) {
    let chunk;
    try {
      chunk = await reader.read();
    } catch (error) {
      throw new CloudsError(`the data of clouds cannot be inflated: ${error instanceof Error ? error.message : error}`);
    }
    if (chunk.done) break;
    if (found + chunk.value.length > expected) {
      void reader.cancel().catch(() => {});
      throw new CloudsError(`the data of clouds inflates to more than ${expected} bytes`);
    }
    bytes.set(chunk.value, found);
    found += chunk.value.length;
  }
  if (found !== expected) throw new CloudsError(`the data of clouds inflates to ${found} bytes instead of ${expected}`);
  return bytes;
}

/**
 * Differences, modulo 2^16.
 *
 * @param {Uint8Array} upper  their upper bytes
 * @param {Uint8Array} lower
 */
function unfolded(upper, lower) {
  return Uint16Array.from(upper, (byte, at) => {
    const folded = (byte << 8) | lower[at];
    return (folded >> 1) ^ -(folded & 1);
  });
}

/**
 * Turns differences from predictions into what was predicted, in place.
 *
 * @param {Uint16Array} plane
 * @param {number} width
 */
function restore(plane, width) {
  for (let at = 0; at < plane.length; at += 1) {
    const is_first = at % width === 0;
    const left = is_first ? 0 : plane[at - 1];
    const up = at < width ? 0 : plane[at - width];
    const corner = is_first || at < width ? 0 : plane[at - width - 1];
    const low = Math.min(left, up);
    const high = Math.max(left, up);
    plane[at] += corner >= high ? low : corner <= low ? high : left + up - corner;
  }
}
