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
    sequence: 70_000,
    width: 640,
    height: 360,
    scene_revision: 12,
    input: 5_000_000_000,
    cell: 3,
    viewer: 4,
    render_unix_us: 1_790_000_000_123_456,
    render_to_encode_us: 111,
    encode_us: 222,
    encode_to_send_us: 333,
    payload_bytes: 3,
  });
});

test("flags are told apart", () => {
  const heartbeat = parseFrameHeader(frameBytes({ codec: 0, flags: 1, payload: new Uint8Array(0) }));
  assert.deepEqual([heartbeat.heartbeat, heartbeat.coarse, heartbeat.codec], [true, false, "none"]);
  const coarse = parseFrameHeader(frameBytes({ codec: 2, flags: 2 }));
  assert.deepEqual([coarse.heartbeat, coarse.coarse, coarse.codec], [false, true, "png"]);
  const stereo = parseFrameHeader(frameBytes({ flags: 4 }));
  assert.deepEqual([stereo.heartbeat, stereo.coarse, stereo.stereo], [false, false, true]);
});

test("bad frames are refused with a reason", () => {
  const refused = (message, reason) => assert.throws(() => parseFrameHeader(message), (error) => error instanceof FrameError && reason.test(error.message));
  refused(new ArrayBuffer(0), /has 0/);
  refused(new ArrayBuffer(63), /has 63/);
  refused(new ArrayBuffer(64), /SKYF/);
  refused(frameBytes({ version: 2 }), /version 2/);
  refused(frameBytes({ codec: 9 }), /codec 9/);
  refused(frameBytes({ said: 4 }), /says 4 bytes of payload, the message has 3/);
  refused(frameBytes({ said: 2 }), /says 2/);
});
