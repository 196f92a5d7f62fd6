import assert from "node:assert/strict";
import test from "node:test";
import { SUBPROTOCOL, connect, retryAfterMs, retryDelayMs } from "../connection.js";
import { frameBytes } from "./frame-bytes.js";

/** What the page sees of a WebSocket, driven by the test instead of a server. */
class FakeWebSocket {
  static OPEN = 1;
  /** @type {FakeWebSocket[]} */
  static made = [];
  readyState = 0;
  bufferedAmount = 0;
  sent = [];
  constructor(url, protocol) {
    Object.assign(this, { url, protocol });
    FakeWebSocket.made.push(this);
  }
  send(text) {
    this.sent.push(JSON.parse(text));
  }
  close() {
    this.readyState = 3;
  }
  open() {
    this.readyState = 1;
    this.onopen();
  }
  say(message) {
    this.onmessage({ data: message instanceof ArrayBuffer ? message : JSON.stringify(message) });
  }
}

const camera = { position_m: [0, 2, 0], yaw_deg: 0, pitch_deg: 12, vertical_fov_deg: 60 };
const welcome = {
  type: "welcome", protocol: 1, viewer: 4, cell: 3, server: "test", adapter: "llvmpipe",
  max_width: 3840, max_height: 2160, max_fps: 60, frame_header_bytes: 96,
};
const afterAnimationFrame = () => new Promise((resolve) => setTimeout(resolve, 30));

/** A connection whose server has said welcome. */
function connected(t) {
  globalThis.WebSocket = FakeWebSocket;
  const connection = connect("ws://sky.test/ws", { view: { width: 640, height: 360, fps: 30 }, camera });
  t.after(() => connection.close());
  const socket = FakeWebSocket.made.at(-1);
  socket.open();
  socket.say(welcome);
  return { connection, socket };
}

test("hello comes first and says everything", (t) => {
  const { socket } = connected(t);
  assert.equal(socket.protocol, SUBPROTOCOL);
  assert.deepEqual(socket.sent, [{ type: "hello", protocol: 1, width: 640, height: 360, fps: 30, camera }]);
});

test("a token that is refused is asked for, and the next hello has the new one", async (t) => {
  globalThis.WebSocket = FakeWebSocket;
  let known = null;
  const refused = [];
  const connection = connect("ws://sky.test/ws", {
    view: { width: 640, height: 360, fps: 30 }, camera,
    token: { current: () => known, refused: async (sent) => (refused.push(sent), (known = "sky_new"), true) },
  });
  t.after(() => connection.close());
  const first = FakeWebSocket.made.at(-1);
  first.open();
  assert.equal("token" in first.sent[0], false);
  known = "sky_from-elsewhere"; // what was sent counts, not what is known when the refusal comes
  first.say({ type: "error", code: "unauthorized", message: "this server needs a token" });
  first.onclose({ code: 4401, reason: "unauthorized" });
  await afterAnimationFrame();
  const second = FakeWebSocket.made.at(-1);
  assert.notEqual(second, first);
  second.open();
  assert.equal(second.sent[0].token, "sky_new");
  assert.deepEqual(refused, [null]);
  second.say(welcome);
  assert.equal(connection.status.state, "open");
});

test("without another token a refused connection ends and does not hammer the server", async (t) => {
  globalThis.WebSocket = FakeWebSocket;
  const connection = connect("ws://sky.test/ws", { view: { width: 64, height: 36, fps: 30 }, camera });
  t.after(() => connection.close());
  const socket = FakeWebSocket.made.at(-1);
  socket.open();
  socket.say({ type: "error", code: "unauthorized", message: "this server needs a token" });
  await afterAnimationFrame();
  assert.equal(connection.status.state, "closed");
  assert.match(connection.status.message, /needs a token/);
  assert.equal(FakeWebSocket.made.at(-1), socket);
});

test("codecs are offered in the hello, one that is set later takes their place, and a key frame can be asked for", (t) => {
  globalThis.WebSocket = FakeWebSocket;
  const view = { width: 640, height: 360, fps: 30, codecs: ["h264", "jpeg"] };
  const connection = connect("ws://sky.test/ws", { view, camera });
  t.after(() => connection.close());
  const socket = FakeWebSocket.made.at(-1);
  connection.requestKeyFrame();
  socket.open();
  socket.say(welcome);
  assert.deepEqual(socket.sent[0].codecs, ["h264", "jpeg"]);
  connection.requestKeyFrame();
  connection.setView({ codec: "jpeg" });
  assert.deepEqual(socket.sent.slice(1), [{ type: "key_frame" }, { type: "view", codec: "jpeg" }]);
  socket.onclose({ code: 1006, reason: "" });
  connection.retryNow();
  const again = FakeWebSocket.made.at(-1);
  again.open();
  assert.equal(again.sent[0].codec, "jpeg");
  assert.equal(again.sent[0].codecs, undefined);
});

test("of many camera changes within an animation frame only the last is sent, and only if it differs", async (t) => {
  const { connection, socket } = connected(t);
  for (let yaw_deg = 1; yaw_deg <= 50; yaw_deg += 1) connection.setCamera({ ...camera, yaw_deg });
  await afterAnimationFrame();
  connection.setCamera({ ...camera, yaw_deg: 50 });
  await afterAnimationFrame();
  assert.deepEqual(socket.sent.slice(1), [{ type: "camera", input: 1, camera: { ...camera, yaw_deg: 50 } }]);
});

test("a line that does not drain gets no further cameras", async (t) => {
  const { connection, socket } = connected(t);
  socket.bufferedAmount = 1e6;
  connection.setCamera({ ...camera, yaw_deg: 7 });
  await afterAnimationFrame();
  assert.equal(socket.sent.length, 1);
  socket.bufferedAmount = 0;
  await afterAnimationFrame();
  assert.equal(socket.sent.at(-1).camera.yaw_deg, 7);
});

test("a frame shown is acknowledged with its times and measures the latency of its input", async (t) => {
  const { connection, socket } = connected(t);
  connection.onFrame((frame) => frame.presented({ decode_us: 1500.4, present_us: 1_790_000_000_200_000 }));
  connection.setCamera({ ...camera, yaw_deg: 7 });
  await afterAnimationFrame();
  socket.say(frameBytes({ input: 1n }));
  const { received_us, motion_to_photon_us, ...ack } = socket.sent.at(-1);
  assert.deepEqual(ack, { type: "ack", sequence: 70_000, decode_us: 1500, present_us: 1_790_000_000_200_000 });
  assert.ok(Math.abs(received_us - Date.now() * 1000) < 1e6, `${received_us}`);
  assert.ok(motion_to_photon_us > 0 && motion_to_photon_us < 1e6, `${motion_to_photon_us} µs`);
  const { latency_ms, frame_age_ms, frames_presented, stages } = connection.status;
  assert.equal(stages.encode_ms, 0.666);
  // The same frame once more shows no new input.
  socket.say(frameBytes({ input: 1n }));
  assert.equal(socket.sent.at(-1).motion_to_photon_us, undefined);
  assert.ok(latency_ms > 0 && latency_ms < 1000, `${latency_ms} ms`);
  assert.equal(frame_age_ms, 76.544);
  assert.equal(frames_presented, 1);
  await new Promise((resolve) => setTimeout(resolve, 600)); // a status
  const { p50, p95 } = connection.status.motion_to_photon_ms;
  assert.ok(p50 === p95 && Math.abs(p50 * 1000 - motion_to_photon_us) <= 1, `${p50} ms`);
});

test("a heartbeat is no frame and wants no acknowledgement", (t) => {
  const { connection, socket } = connected(t);
  connection.onFrame(() => assert.fail("a heartbeat reached the frame handler"));
  socket.say(frameBytes({ codec: 0, flags: 1, payload: new Uint8Array(0) }));
  assert.equal(socket.sent.length, 1);
});

test("only changed wishes are sent", (t) => {
  const { connection, socket } = connected(t);
  connection.setView({ width: 640, height: 360 });
  connection.setView({ width: 1280, height: 360 });
  assert.deepEqual(socket.sent.slice(1), [{ type: "view", width: 1280 }]);
});

test("after an outage the session starts anew with the newest wishes", async (t) => {
  const { connection, socket } = connected(t);
  connection.setCamera({ ...camera, yaw_deg: 90 });
  connection.setView({ fps: 15 });
  socket.onclose({ code: 1006, reason: "" });
  assert.equal(connection.status.state, "waiting");
  assert.equal(connection.status.message, "Connection lost, trying again");
  assert.equal(connection.status.retry_in_s, 1);
  connection.retryNow();
  const next = FakeWebSocket.made.at(-1);
  assert.notEqual(next, socket);
  next.open();
  assert.deepEqual(next.sent, [{ type: "hello", protocol: 1, width: 640, height: 360, fps: 15, camera: { ...camera, yaw_deg: 90 } }]);
});

test("an acknowledgement never reaches the session after its own", (t) => {
  const { connection, socket } = connected(t);
  const frames = [];
  connection.onFrame((frame) => frames.push(frame));
  socket.say(frameBytes());
  socket.onclose({ code: 1006, reason: "" });
  connection.retryNow();
  const next = FakeWebSocket.made.at(-1);
  next.open();
  next.say(welcome);
  frames[0].presented({ decode_us: 1, present_us: 1 });
  assert.deepEqual(next.sent.map(({ type }) => type), ["hello"]);
});

test("the server's complaint is shown, and a wrong protocol ends the tries", (t) => {
  const { connection, socket } = connected(t);
  socket.say({ type: "error", code: "bad-value", pointer: "/camera/yaw_deg", message: "/camera/yaw_deg is 1e7; allowed: …" });
  assert.equal(connection.status.problem, "/camera/yaw_deg is 1e7; allowed: …");
  assert.equal(connection.status.state, "open");
  socket.say({ type: "error", code: "wrong-protocol", message: "speaks 2" });
  assert.equal(connection.status.state, "closed");
  assert.match(connection.status.message, /reload/);
});

test("a frame of another version ends the connection with a reason", (t) => {
  const { connection, socket } = connected(t);
  socket.say(frameBytes({ version: 3 }));
  assert.equal(connection.status.state, "closed");
  assert.match(connection.status.message, /version 3/);
});

test("a server that closes says when to come back, and its time is taken", () => {
  assert.equal(retryAfterMs("the server shuts down; retry_after_s=1.75"), 1750);
  assert.equal(retryAfterMs("the server shuts down; retry_after_s=99"), 15_000);
  assert.equal(retryAfterMs("no progress"), null);
  assert.equal(retryAfterMs(""), null);
});

test("waits double, stay within 15 s and keep their upper half random", () => {
  assert.equal(retryDelayMs(1, 0), 250);
  assert.equal(retryDelayMs(1, 1), 500);
  assert.equal(retryDelayMs(3, 1), 2000);
  assert.equal(retryDelayMs(1000, 1), 15_000);
  assert.equal(retryDelayMs(1000, 0), 7_500);
});
