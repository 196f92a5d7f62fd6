import assert from "node:assert/strict";
import test from "node:test";
import { FrameError, parseFrameHeader } from "../frame-header.js";
import { frameBytes } from "./frame-bytes.js";

test("every field is read from its own place", () => {
  assert.deepEqual(parseFrameHeader(frameBytes()), {
    codec: "jpeg",
    heartbeat: false,
    coarse: false,
    stereo: false,
    key: true,
    exact: false,
    sequence: 70_000,
    width: 640,
    height: 360,
    scene_revision: 12,
    input: 5_000_000_000,
    cell: 3,
    viewer: 4,
    render_unix_us: 1_790_000_000_123_456,
    input_to_render_us: 111,
    march_wait_us: 222,
    composite_us: 333,
    readback_us: 444,
    encode_wait_us: 555,
    encode_us: 666,
    encode_to_send_us: 777,
    payload_bytes: 3,
    target_kbit_per_s: 888,
    colours: null,
  });
});

test("how colours are spread is told where they are", () => {
  const bytes = frameBytes();
  new Uint8Array(bytes).set([140, 117, 5], 84);
  assert.deepEqual(parseFrameHeader(bytes).colours, { centre: [140, 117], gain: 5 });
});

test("flags are told apart", () => {
  const heartbeat = parseFrameHeader(frameBytes({ codec: 0, flags: 1, payload: new Uint8Array(0) }));
  assert.deepEqual([heartbeat.heartbeat, heartbeat.coarse, heartbeat.codec], [true, false, "none"]);
  assert.deepEqual([heartbeat.key, heartbeat.exact], [false, false]);
  const coarse = parseFrameHeader(frameBytes({ codec: 2, flags: 2 }));
  assert.deepEqual([coarse.heartbeat, coarse.coarse, coarse.codec], [false, true, "png"]);
  const stereo = parseFrameHeader(frameBytes({ flags: 4 }));
  assert.deepEqual([stereo.heartbeat, stereo.coarse, stereo.stereo], [false, false, true]);
  const key = parseFrameHeader(frameBytes({ codec: 3, flags: 8 }));
  assert.deepEqual([key.stereo, key.key, key.exact, key.codec], [false, true, false, "h264"]);
  const exact = parseFrameHeader(frameBytes({ codec: 4, flags: 16 }));
  assert.deepEqual([exact.key, exact.exact, exact.codec], [false, true, "clouds"]);
});

test("bad frames are refused with a reason", () => {
  const refused = (message, reason) => assert.throws(() => parseFrameHeader(message), (error) => error instanceof FrameError && reason.test(error.message));
  refused(new ArrayBuffer(0), /has 0/);
  refused(new ArrayBuffer(95), /has 95/);
  refused(new ArrayBuffer(96), /SKYF/);
  refused(frameBytes({ version: 1 }), /version 1/);
  refused(frameBytes({ version: 3 }), /version 3/);
  refused(frameBytes({ codec: 9 }), /codec 9/);
  refused(frameBytes({ said: 4 }), /says 4 bytes of payload, the message has 3/);
  refused(frameBytes({ said: 2 }), /says 2/);
});
