// @ts-check
/**
 * The 96 bytes in front of every frame, little-endian. The layout's home is `protocol/src/frame.rs`.
 *
 * @typedef {object} FrameHeader
 * @property {"none" | "jpeg" | "png" | "h264" | "clouds"} codec  how the payload is encoded; "none" for a heartbeat
 * @property {boolean} heartbeat  nothing new to show: no payload, only a sign of life
 * @property {boolean} coarse  some visible part is not yet at the resolution that was asked for
 * @property {boolean} stereo  the picture holds those of two eyes side by side, the left eye's on the left
 * @property {boolean} key  the picture needs no earlier one
 * @property {boolean} exact  nothing finer comes while the view rests
 * @property {number} sequence  counts this viewer's frames; an acknowledgement names it
 * @property {number} width  pixels, of both eyes together where there are two
 * @property {number} height  pixels
 * @property {number} scene_revision  revision of the scene that the picture shows
 * @property {number} input  the last camera input that the picture shows; 0 is the camera of hello
 * @property {number} cell  view cell whose caches the picture was read from
 * @property {number} viewer  the viewer it was made for
 * @property {number} render_unix_us  server's clock when the composite was submitted, µs since 1970
 * @property {number} input_to_render_us  from the arrival of `input` at the server until the composite was submitted; 0 where none was new
 * @property {number} march_wait_us  of that, waiting for marching
 * @property {number} composite_us  device time of the picture
 * @property {number} readback_us  the rest until the pixels had arrived
 * @property {number} encode_wait_us  waiting for an encoder
 * @property {number} encode_us
 * @property {number} encode_to_send_us  waiting for the socket
 * @property {number} payload_bytes
 * @property {number} target_kbit_per_s  the rate that compression aims at; 0 where there is none
 * @property {{ centre: [number, number], gain: number } | null} colours  how a video's colours are spread (video-colours.js); null
 *   where they are as the stream says itself
 */

/** Bytes before the payload. */
export const FRAME_HEADER_BYTES = 96;

const MAGIC = 0x46594b53; // "SKYF" read as a little-endian u32
const VERSION = 2;
const FLAG_HEARTBEAT = 1;
const FLAG_COARSE = 2;
const FLAG_STEREO = 4;
const FLAG_KEY = 8;
const FLAG_EXACT = 16;
const CODECS = /** @type {const} */ (["none", "jpeg", "png", "h264", "clouds"]);

/** A frame that does not follow the protocol. */
export class FrameError extends Error {
  name = "FrameError";
}

/**
 * Reads the header of a binary message and checks that the payload is as long as it says.
 *
 * @param {ArrayBuffer} message
 * @returns {FrameHeader}
 * @throws {FrameError} names what is wrong
 */
export function parseFrameHeader(message) {
  if (message.byteLength < FRAME_HEADER_BYTES) {
    throw new FrameError(`a frame has at least ${FRAME_HEADER_BYTES} bytes, this one has ${message.byteLength}`);
  }
  const view = new DataView(message, 0, FRAME_HEADER_BYTES);
  const magic = view.getUint32(0, true);
  if (magic !== MAGIC) {
    throw new FrameError(`a frame starts with "SKYF", this one with 0x${magic.toString(16)}`);
  }
  const version = view.getUint8(4);
  if (version !== VERSION) {
    throw new FrameError(`frame version ${version} is not known here, only ${VERSION}: reload the page`);
  }
  const codec = CODECS[view.getUint8(5)];
  if (codec === undefined) {
    throw new FrameError(`codec ${view.getUint8(5)} is not known here`);
  }
  const flags = view.getUint16(6, true);
  const gain = view.getUint8(86);
  const payload_bytes = view.getUint32(76, true);
  if (message.byteLength !== FRAME_HEADER_BYTES + payload_bytes) {
    throw new FrameError(
      `the header says ${payload_bytes} bytes of payload, the message has ${message.byteLength - FRAME_HEADER_BYTES}`,
    );
  }
  return {
    codec,
    heartbeat: (flags & FLAG_HEARTBEAT) !== 0,
    coarse: (flags & FLAG_COARSE) !== 0,
    stereo: (flags & FLAG_STEREO) !== 0,
    key: (flags & FLAG_KEY) !== 0,
    exact: (flags & FLAG_EXACT) !== 0,
    sequence: view.getUint32(8, true),
    width: view.getUint16(12, true),
    height: view.getUint16(14, true),
    // Doubles are exact to 2^53: revisions and inputs never get there, and µs since 1970 do in the year 2255.
    scene_revision: Number(view.getBigUint64(16, true)),
    input: Number(view.getBigUint64(24, true)),
    cell: view.getUint32(32, true),
    viewer: view.getUint32(36, true),
    render_unix_us: Number(view.getBigUint64(40, true)),
    input_to_render_us: view.getUint32(48, true),
    march_wait_us: view.getUint32(52, true),
    composite_us: view.getUint32(56, true),
    readback_us: view.getUint32(60, true),
    encode_wait_us: view.getUint32(64, true),
    encode_us: view.getUint32(68, true),
    encode_to_send_us: view.getUint32(72, true),
    payload_bytes,
    target_kbit_per_s: view.getUint32(80, true),
    colours: gain === 0 ? null : { centre: [view.getUint8(84), view.getUint8(85)], gain },
  };
}
