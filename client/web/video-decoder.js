// @ts-check
/**
 * Decodes what a connection sends: JPEG and PNG as pictures by themselves, H.264 with WebCodecs, one access unit per frame in
 * Annex B form, without a description.
 *
 * Pictures of a video build on one another, so every frame of it goes in, in order. What cannot be decoded asks for a key
 * frame, once a second at most; when that fails again and again, the decoder gives up and says why.
 */

import { canSpreadColours, createColourReader } from "./video-colours.js";

/** @typedef {import("./connection.js").Frame} Frame */
/** @typedef {{ picture: ImageBitmap | VideoFrame, width: number, height: number }} Decoded  to be closed by who gets it */

/** Constrained baseline, level 4.2: what the server sends up to 1920 x 1088. */
const PROBED_CODEC = "avc1.42c02a";
const KEY_FRAME_PERIOD_MS = 1_100;
/** So many failures within so long are not the line's. */
const FAILURES_MAX = 3;
const FAILURES_WITHIN_MS = 30_000;
/** A decoder that gives no picture for this long is stuck. */
const DECODE_LIMIT_MS = 2_000;

/**
 * What this browser can take, what it likes best first, for the hello of a connection.
 * @returns {Promise<("h264" | "jpeg")[]>}
 */
export async function supportedCodecs() {
  if (typeof VideoDecoder !== "function" || typeof EncodedVideoChunk !== "function") return ["jpeg"];
  try {
    const { supported } = await VideoDecoder.isConfigSupported({ codec: PROBED_CODEC, optimizeForLatency: true });
    return supported ? ["h264", "jpeg"] : ["jpeg"];
  } catch {
    return ["jpeg"];
  }
}

/** Planes of a picture in a graphics card's own memory could not be read. */
const READABLE = /** @type {const} */ ({ hardwareAcceleration: "prefer-software" });

/**
 * Whether it can put a video's colours back that the server has spread; for the hello of a connection.
 * @returns {Promise<boolean>}
 */
export async function takesScaledColours() {
  if (typeof VideoDecoder !== "function" || !canSpreadColours()) return false;
  try {
    const { supported } = await VideoDecoder.isConfigSupported({ codec: PROBED_CODEC, optimizeForLatency: true, ...READABLE });
    return supported === true;
  } catch {
    return false;
  }
}

/**
 * The codec string of an access unit that begins a stream: profile, constraints and level of its sequence parameter set.
 * @param {Uint8Array} access_unit  Annex B
 * @returns {string | null}  null where it has none
 */
export function codecOf(access_unit) {
  for (let at = 0; at + 6 < access_unit.length; at += 1) {
    const begins = access_unit[at] === 0 && access_unit[at + 1] === 0 && access_unit[at + 2] === 1;
    if (begins && (/** @type {number} */ (access_unit[at + 3]) & 0x1f) === 7) {
      const bytes = [...access_unit.subarray(at + 4, at + 7)];
      return `avc1.${bytes.map((byte) => byte.toString(16).padStart(2, "0")).join("")}`;
    }
  }
  return null;
}

/**
 * A picture of a file's bytes.
 * @param {Frame} frame
 * @returns {Promise<Decoded>}
 */
export async function decodeImage(frame) {
  const blob = new Blob([frame.payload], { type: `image/${frame.header.codec}` });
  const picture = await createImageBitmap(blob, { colorSpaceConversion: "none" });
  return { picture, width: picture.width, height: picture.height };
}

/**
 * @param {object} options
 * @param {() => void} options.askForKeyFrame
 * @param {(reason: string) => void} options.onGivenUp  it decodes no video any more
 * @returns {(frame: Frame) => Promise<Decoded>}  for one frame at a time; rejects where it gives no picture
 */
export function createDecoder({ askForKeyFrame, onGivenUp }) {
  /** @type {VideoDecoder | null} */
  let decoder = null;
  let codec = "";
  let timestamp = 0;
  /** Who waits for the picture. @type {{ resolve: (picture: VideoFrame) => void, reject: (error: Error) => void } | null} */
  let waiting = null;
  let given_up = false;
  let asked_ms = Number.NEGATIVE_INFINITY;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  let ask_timer;
  /** @type {ReturnType<typeof createColourReader> | null} */
  let readColours = null;
  /** When it failed, ms. @type {number[]} */
  let failures = [];

  const close = () => {
    if (decoder && decoder.state !== "closed") decoder.close();
    decoder = null;
    codec = "";
  };

  const ask = () => {
    clearTimeout(ask_timer);
    if (decoder || given_up) return;
    const wait_ms = asked_ms + KEY_FRAME_PERIOD_MS - performance.now();
    if (wait_ms <= 0) {
      asked_ms = performance.now();
      askForKeyFrame();
    }
    // A view that rests sends nothing that would ask again.
    ask_timer = setTimeout(ask, wait_ms > 0 ? wait_ms : KEY_FRAME_PERIOD_MS);
  };

  const fail = (/** @type {string} */ reason) => {
    close();
    const now_ms = performance.now();
    failures = [...failures.filter((at_ms) => now_ms - at_ms < FAILURES_WITHIN_MS), now_ms];
    if (failures.length < FAILURES_MAX) {
      ask();
    } else if (!given_up) {
      given_up = true;
      clearTimeout(ask_timer);
      onGivenUp(reason);
    }
  };

  const open = (/** @type {string} */ wanted, /** @type {boolean} */ are_planes_read) => {
    if (decoder && codec === wanted) return decoder;
    close();
    const opened = new VideoDecoder({
      output(picture) {
        if (opened === decoder && waiting) waiting.resolve(picture);
        else picture.close();
      },
      error(error) {
        if (opened !== decoder) return;
        if (waiting) waiting.reject(error);
        else fail(error.message);
      },
    });
    opened.configure({ codec: wanted, optimizeForLatency: true, ...(are_planes_read ? READABLE : {}) });
    decoder = opened;
    codec = wanted;
    clearTimeout(ask_timer);
    return opened;
  };

  /** @param {Frame} frame */
  const decodeVideo = async ({ header, payload }) => {
    if (given_up || (!decoder && !header.key)) {
      ask();
      throw new Error("a picture that builds on one that is not here");
    }
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    let limit;
    try {
      const wanted = header.key ? codecOf(payload) : codec;
      if (!wanted) throw new Error("a key frame without a sequence parameter set");
      const into = open(wanted, Boolean(header.colours));
      timestamp += 1;
      const picture = await new Promise((/** @type {(picture: VideoFrame) => void} */ resolve, reject) => {
        waiting = { resolve, reject };
        limit = setTimeout(() => reject(new Error("the decoder takes a frame and gives none")), DECODE_LIMIT_MS);
        into.decode(new EncodedVideoChunk({ type: header.key ? "key" : "delta", timestamp, data: payload }));
      });
      const { width, height } = header;
      if (header.colours) {
        try {
          readColours ??= createColourReader();
          return { picture: await readColours(picture, header, header.colours), width, height };
        } finally {
          picture.close();
        }
      }
      if (picture.displayWidth === width && picture.displayHeight === height) return { picture, width, height };
      // The encoder's sides are even; what is beyond the frame repeats its edge.
      const cut = await createImageBitmap(picture, 0, 0, width, height);
      picture.close();
      return { picture: cut, width, height };
    } catch (error) {
      fail(error instanceof Error ? error.message : String(error));
      throw error;
    } finally {
      clearTimeout(limit);
      waiting = null;
    }
  };

  return (frame) => (frame.header.codec === "h264" ? decodeVideo(frame) : decodeImage(frame));
}
