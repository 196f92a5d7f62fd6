// @ts-check
/**
 * Where the time goes between an input and the screen.
 *
 * @typedef {import("./frame-header.js").FrameHeader} FrameHeader
 */

/**
 * @typedef {object} Stages  how long a frame took, ms; null: not known
 * @property {number | null} input_ms  from the input's arrival at the server until the composite was submitted; null where no input was new
 * @property {number | null} march_wait_ms  of that, waiting for marching
 * @property {number | null} composite_ms  device time of the picture
 * @property {number} readback_ms  waiting for the device, and the copy
 * @property {number} encode_wait_ms
 * @property {number} encode_ms
 * @property {number} to_socket_ms  waiting for the socket
 * @property {number | null} network_ms  from the socket to here, by the two machines' clocks; null where they differ by more
 * @property {number} decode_ms
 * @property {number} present_ms  from decoding to the screen
 */

/** @typedef {{ p50: number, p95: number }} Percentiles  what half, and 95 of 100, do not exceed */

/** Longer than any way: then it is the clocks that differ. */
const NETWORK_LONGEST_MS = 60_000;

/**
 * @param {FrameHeader} header
 * @param {{ received_us: number, decode_us: number, present_us: number }} times  µs since 1970, and a duration
 * @returns {Stages}
 */
export function stagesOf(header, { received_us, decode_us, present_us }) {
  const ms = (/** @type {number} */ us) => us / 1000;
  const has_input = header.input_to_render_us > 0;
  const sent_us =
    header.render_unix_us +
    header.composite_us +
    header.readback_us +
    header.encode_wait_us +
    header.encode_us +
    header.encode_to_send_us;
  const network_ms = ms(received_us - sent_us);
  return {
    input_ms: has_input ? ms(header.input_to_render_us) : null,
    march_wait_ms: has_input ? ms(header.march_wait_us) : null,
    composite_ms: header.composite_us > 0 ? ms(header.composite_us) : null,
    readback_ms: ms(header.readback_us),
    encode_wait_ms: ms(header.encode_wait_us),
    encode_ms: ms(header.encode_us),
    to_socket_ms: ms(header.encode_to_send_us),
    network_ms: network_ms >= 0 && network_ms < NETWORK_LONGEST_MS ? network_ms : null,
    decode_ms: ms(decode_us),
    present_ms: Math.max(0, ms(present_us - received_us - decode_us)),
  };
}

/** The latest of some times. */
export class RecentTimes {
  /** @type {number[]} */ #times = [];
  #next = 0;
  #most;

  /** @param {number} most  how many are kept */
  constructor(most) {
    this.#most = most;
  }

  /** @param {number} time */
  push(time) {
    this.#times[this.#next] = time;
    this.#next = (this.#next + 1) % this.#most;
  }

  clear() {
    this.#times.length = 0;
    this.#next = 0;
  }

  /** By nearest rank; null without times. @returns {Percentiles | null} */
  percentiles() {
    if (this.#times.length === 0) return null;
    const sorted = [...this.#times].sort((a, b) => a - b);
    const at = (/** @type {number} */ percent) => /** @type {number} */ (sorted[Math.max(0, Math.ceil((sorted.length * percent) / 100) - 1)]);
    return { p50: at(50), p95: at(95) };
  }
}
