// @ts-check
/**
 * Server-sent events over fetch, because an EventSource sends no token and gives up where it is told to come back later
 * (503). The stream is opened again after a wait that doubles, half of it random, and goes on behind the last event.
 */

import { retryDelayMs } from "./connection.js";

/** An event of this server has some kB at most. */
const EVENT_MAX_CHARS = 1 << 20;
/** A stream that ends sooner than this does not count as a success, or a server that ends each would be hammered. */
const STABLE_AFTER_MS = 5_000;
/** The server says something each 15 s: after this long without a word the line is dead. */
const SILENCE_LIMIT_MS = 45_000;
/** No server keeps a page waiting for longer by what it tells. */
const RETRY_AFTER_MAX_MS = 60_000;

/**
 * How long to wait before the next try: what the server asks for at least, then spread, so that a crowd does not return as one.
 * @param {number} failures  in a row, at least 1
 * @param {string | null} retry_after  the header, in seconds
 * @param {number} random  0 to 1
 */
export function reopenDelayMs(failures, retry_after, random) {
  const seconds = retry_after === null || retry_after.trim() === "" ? Number.NaN : Number(retry_after);
  const asked_ms = Number.isFinite(seconds) && seconds > 0 ? Math.min(RETRY_AFTER_MAX_MS, seconds * 1000) : 0;
  return asked_ms + retryDelayMs(failures, random);
}

/** @param {number} ms @param {AbortSignal} signal @returns {Promise<void>} */
const pause = (ms, signal) =>
  new Promise((resolve) => {
    const timer = setTimeout(resolve, ms);
    signal.addEventListener("abort", () => (clearTimeout(timer), resolve()), { once: true });
  });

/**
 * @param {string | URL} url
 * @param {(name: string, data: string) => void} onEvent
 * @param {object} [options]  for tests
 * @param {typeof pause} [options.wait]
 * @param {() => number} [options.random]
 * @param {number} [options.silence_ms]
 * @returns {() => void}  ends it
 */
export function watchEvents(url, onEvent, { wait = pause, random = Math.random, silence_ms = SILENCE_LIMIT_MS } = {}) {
  const ended = new AbortController();
  let last_id = "";
  let failures = 0;
  /** @returns {Promise<string | null | undefined>}  what the server says of when to come back; undefined: never */
  const watch = async () => {
    const line = new AbortController();
    const cut = () => line.abort();
    ended.signal.addEventListener("abort", cut, { once: true });
    /** @type {ReturnType<typeof setTimeout> | undefined} */
    let silence;
    const heard = () => {
      clearTimeout(silence);
      silence = setTimeout(cut, silence_ms);
    };
    /** @type {Record<string, string>} */
    const headers = { Accept: "text/event-stream" };
    if (last_id !== "") headers["Last-Event-ID"] = last_id;
    try {
      heard();
      const answer = await fetch(url, { signal: line.signal, headers });
      // Who may not watch will not be let in by asking again.
      if (answer.status === 401 || answer.status === 403) return undefined;
      if (!answer.ok || !answer.body) return answer.headers.get("retry-after");
      const opened_ms = performance.now();
      await readEvents(answer.body, heard, ({ name, data, id }) => {
        if (data !== "") onEvent(name, data);
        if (id !== null) last_id = id;
      }).finally(() => {
        if (performance.now() - opened_ms >= STABLE_AFTER_MS) failures = 0;
      });
      return null;
    } catch {
      return null; // The line broke, was silent for too long, or it was ended.
    } finally {
      clearTimeout(silence);
      ended.signal.removeEventListener("abort", cut);
    }
  };
  void (async () => {
    while (!ended.signal.aborted) {
      const retry_after = await watch();
      if (retry_after === undefined || ended.signal.aborted) return;
      failures += 1;
      await wait(reopenDelayMs(failures, retry_after, random()), ended.signal);
    }
  })();
  return () => ended.abort();
}

/**
 * @param {ReadableStream<Uint8Array>} body
 * @param {() => void} onHeard  something has come, if only a comment
 * @param {(event: StreamEvent) => void} onEvent
 */
async function readEvents(body, onHeard, onEvent) {
  const reader = body.getReader();
  const decoder = new TextDecoder();
  let text = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    onHeard();
    text += decoder.decode(value, { stream: true });
    if (text.length > EVENT_MAX_CHARS) throw new Error("an event has no end");
    const blocks = text.split(/\r?\n\r?\n/);
    text = blocks.pop() ?? "";
    for (const block of blocks) onEvent(parseEvent(block));
  }
}

/** @typedef {{ name: string, data: string, id: string | null }} StreamEvent */

/**
 * One event of a stream, without the empty line at its end.
 * @param {string} block
 * @returns {StreamEvent}
 */
export function parseEvent(block) {
  /** @type {StreamEvent} */
  const event = { name: "message", data: "", id: null };
  const data = [];
  for (const line of block.split(/\r?\n/)) {
    const at = line.indexOf(":");
    const field = at < 0 ? line : line.slice(0, at);
    const value = at < 0 ? "" : line.slice(at + 1).replace(/^ /, "");
    if (field === "event") event.name = value;
    else if (field === "id") event.id = value;
    else if (field === "data") data.push(value);
  }
  event.data = data.join("\n");
  return event;
}
