import { FRAME_HEADER_BYTES } from "../frame-header.js";

/** A frame as the server would write it, byte by byte after the protocol's table. */
export function frameBytes({
  codec = 1,
  flags = 8,
  payload = new Uint8Array([1, 2, 3]),
  said = payload.length,
  version = 2,
  input = 5_000_000_000n,
} = {}) {
  const bytes = new Uint8Array(FRAME_HEADER_BYTES + payload.length);
  const view = new DataView(bytes.buffer);
  bytes.set([0x53, 0x4b, 0x59, 0x46, version, codec]); // "SKYF"
  view.setUint16(6, flags, true);
  view.setUint32(8, 70_000, true);
  view.setUint16(12, 640, true);
  view.setUint16(14, 360, true);
  view.setBigUint64(16, 12n, true);
  view.setBigUint64(24, input, true);
  view.setUint32(32, 3, true);
  view.setUint32(36, 4, true);
  view.setBigUint64(40, 1_790_000_000_123_456n, true);
  // input_to_render_us to encode_to_send_us
  [111, 222, 333, 444, 555, 666, 777].forEach((duration_us, place) => view.setUint32(48 + 4 * place, duration_us, true));
  view.setUint32(76, said, true);
  view.setUint32(80, 888, true);
  bytes.set(payload, FRAME_HEADER_BYTES);
  return bytes.buffer;
}
