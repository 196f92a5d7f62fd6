import assert from "node:assert/strict";
import test from "node:test";
import { parseFrameHeader } from "../frame-header.js";
import { RecentTimes, stagesOf } from "../latency.js";
import { frameBytes } from "./frame-bytes.js";

test("each stage is told in ms and together they lead from the composite to the screen", () => {
  const header = parseFrameHeader(frameBytes());
  const sent_us = header.render_unix_us + 333 + 444 + 555 + 666 + 777;
  const times = { received_us: sent_us + 5_000, decode_us: 3_000, present_us: sent_us + 12_000 };
  const stages = stagesOf(header, times);
  assert.deepEqual(stages, {
    input_ms: 0.111,
    march_wait_ms: 0.222,
    composite_ms: 0.333,
    readback_ms: 0.444,
    encode_wait_ms: 0.555,
    encode_ms: 0.666,
    to_socket_ms: 0.777,
    network_ms: 5,
    decode_ms: 3,
    present_ms: 4,
  });
  const { input_ms, march_wait_ms, ...later } = stages;
  const sum_ms = Object.values(later).reduce((sum, ms) => sum + ms, 0);
  assert.ok(Math.abs(sum_ms - (times.present_us - header.render_unix_us) / 1000) < 1e-9);
});

test("what is not known is null", () => {
  const header = { ...parseFrameHeader(frameBytes()), input_to_render_us: 0, composite_us: 0 };
  const ahead = { received_us: header.render_unix_us - 1, decode_us: 0, present_us: 0 };
  const stages = stagesOf(header, ahead);
  assert.deepEqual(
    [stages.input_ms, stages.march_wait_ms, stages.composite_ms, stages.network_ms, stages.present_ms],
    [null, null, null, null, 0],
  );
});

test("percentiles are those of the latest times", () => {
  const times = new RecentTimes(100);
  assert.equal(times.percentiles(), null);
  for (let ms = 1; ms <= 100; ms += 1) times.push(ms);
  assert.deepEqual(times.percentiles(), { p50: 50, p95: 95 });
  for (let count = 0; count < 1000; count += 1) times.push(7);
  assert.deepEqual(times.percentiles(), { p50: 7, p95: 7 });
  times.clear();
  assert.equal(times.percentiles(), null);
});
