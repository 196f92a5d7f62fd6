import assert from "node:assert/strict";
import test from "node:test";
import { codecOf, createDecoder, supportedCodecs } from "../video-decoder.js";

/** What the module sees of WebCodecs; a real browser plays the real thing in `tests/tests/video.rs`. */
class FakeVideoDecoder {
  /** @type {FakeVideoDecoder[]} */
  static made = [];
  static fails = false;
  static async isConfigSupported() {
    return { supported: true };
  }
  state = "unconfigured";
  constructor(callbacks) {
    Object.assign(this, callbacks);
    FakeVideoDecoder.made.push(this);
  }
  configure(config) {
    this.config = config;
    this.state = "configured";
  }
  decode(chunk) {
    if (FakeVideoDecoder.fails) this.error(new Error("planted"));
    else this.output({ displayWidth: 4, displayHeight: 2, timestamp: chunk.timestamp, close() {} });
  }
  close() {
    this.state = "closed";
  }
}

const KEY = new Uint8Array([0, 0, 0, 1, 0x67, 0x42, 0xc0, 0x2a, 0x8c, 0, 0, 0, 1, 0x68, 0xce, 0, 0, 1, 0x65, 1]);
const frame = (key) => ({
  header: { codec: "h264", key, width: 4, height: 2 },
  payload: key ? KEY : new Uint8Array([0, 0, 0, 1, 0x41, 1]),
});

function decoder(t, { fails = false } = {}) {
  FakeVideoDecoder.made = [];
  FakeVideoDecoder.fails = fails;
  globalThis.VideoDecoder = FakeVideoDecoder;
  globalThis.EncodedVideoChunk = class {
    constructor(chunk) {
      Object.assign(this, chunk);
    }
  };
  t.mock.timers.enable({ apis: ["setTimeout"] });
  const said = { asked: 0, given_up: [] };
  const decode = createDecoder({
    askForKeyFrame: () => (said.asked += 1),
    onGivenUp: (reason) => said.given_up.push(reason),
  });
  return { decode, said };
}

test("the codec is that of the sequence parameter set", () => {
  assert.equal(codecOf(KEY), "avc1.42c02a");
  assert.equal(codecOf(frame(false).payload), null);
  assert.equal(codecOf(new Uint8Array()), null);
});

test("a browser without WebCodecs takes JPEG alone", async (t) => {
  decoder(t);
  assert.deepEqual(await supportedCodecs(), ["h264", "jpeg"]);
  delete globalThis.VideoDecoder;
  assert.deepEqual(await supportedCodecs(), ["jpeg"]);
});

test("one decoder plays a stream, and a key of another codec opens another", async (t) => {
  const { decode, said } = decoder(t);
  for (const key of [true, false, false, true]) assert.equal((await decode(frame(key))).width, 4);
  assert.equal(FakeVideoDecoder.made.length, 1);
  const other = frame(true);
  other.payload = KEY.map((byte) => (byte === 0x2a ? 0x34 : byte));
  await decode(other);
  assert.deepEqual(FakeVideoDecoder.made.map(({ config }) => config.codec), ["avc1.42c02a", "avc1.42c034"]);
  assert.equal(FakeVideoDecoder.made[0].state, "closed");
  assert.equal(said.asked, 0);
});

test("what lacks its key asks for one, and not more often than once a second", async (t) => {
  const { decode, said } = decoder(t);
  for (let frames = 0; frames < 20; frames += 1) await assert.rejects(decode(frame(false)));
  assert.equal(said.asked, 1);
});

test("a decoder that fails again and again gives up and says why", async (t) => {
  const { decode, said } = decoder(t, { fails: true });
  for (let tries = 0; tries < 3; tries += 1) await assert.rejects(decode(frame(true)), /planted/);
  assert.deepEqual(said.given_up, ["planted"]);
  assert.equal(said.asked, 1);
  await assert.rejects(decode(frame(true)));
  assert.equal(FakeVideoDecoder.made.length, 3);
});
