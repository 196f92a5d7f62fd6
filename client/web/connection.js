// @ts-check
/**
 * A viewer's connection to a Skycell server. Needs no page: embed it with
 *
 *     import { connect } from "./connection.js";
 *     const connection = connect("ws://localhost:8080/ws", { view: { width: 960, height: 540, fps: 30 }, camera });
 *     connection.onFrame((frame) => draw(frame).then(() => frame.presented({ decode_us, present_us })));
 *     connection.onStatus((status) => console.log(status.message));
 *     connection.setCamera({ ...camera, yaw_deg: 90 });
 *
 * Every frame wants its `presented()`: the server sends no more than two that were not acknowledged. A lost connection
 * comes back by itself and goes on with the newest picture; nothing of the outage is replayed. `video-decoder.js` decodes
 * frames, H.264 among them, and tells which codecs a browser can take.
 */

import { FrameError, parseFrameHeader } from "./frame-header.js";
import { RecentTimes, stagesOf } from "./latency.js";

/** @typedef {import("./look.js").Camera} Camera */
/** @typedef {import("./frame-header.js").FrameHeader} FrameHeader */

/**
 * @typedef {object} View  what a viewer wishes
 * @property {number} width  pixels, at most `welcome.max_width`; with two eyes those of one, at most half of it
 * @property {number} height  pixels, at most `welcome.max_height`
 * @property {number} fps  1 to 120
 * @property {"jpeg" | "png" | "h264" | "clouds"} [codec]  clouds: clouds alone, for a renderer of your own (clouds.js)
 * @property {("jpeg" | "png" | "h264" | "clouds")[]} [codecs]  what can be decoded, what is liked best first; the server picks.
 *   `codec` set later takes its place
 * @property {number} [jpeg_quality]  1 to 100
 * @property {Quality | null} [quality]  null: what the scene or the server says
 * @property {string} [show]  name of a view, as `/api/v1/views` lists them
 * @property {Stereo | null} [stereo]  two eyes, side by side in each frame; null: one
 * @property {boolean} [haze]  colour of clouds alone includes the haze in front of them (true)
 * @property {boolean} [scaled_colours]  a video's colours may be spread as frame headers say, which video-colours.js undoes (false)
 */

/** @typedef {{ eye_distance_m: number }} Stereo  0 to 100 m */

/**
 * @typedef {{ preset: "draft" | "balanced" | "high" | "reference" } | { max_error: number } | { budget_ms: number }} Quality
 *   a named quality, the largest mean FLIP (0.001 to 1), or the device's time for a frame (0.1 to 1000 ms)
 */

/**
 * @typedef {object} Token
 * @property {() => string | null} current  sent with every hello
 * @property {(sent: string | null) => Promise<boolean>} refused  the server does not take what was sent: whether there is
 *   another one to try
 */

/**
 * @typedef {object} PickedQuality  what the server has picked
 * @property {string} name  of the preset, or "custom"
 * @property {number} flip  mean FLIP against the converged picture
 * @property {boolean} measured  false: the FLIP is an estimate
 * @property {boolean} is_met  it is as good, or as fast, as was asked for
 * @property {number | null} device_ms  device time of a frame
 */

/**
 * @typedef {object} Welcome
 * @property {number} protocol
 * @property {number} viewer
 * @property {number | null} cell  null until the renderer has placed the viewer
 * @property {string} server
 * @property {string} adapter
 * @property {number} max_width
 * @property {number} max_height
 * @property {number} max_fps
 * @property {number} frame_header_bytes
 * @property {"jpeg" | "png" | "h264" | "clouds"} codec  the one that the server has picked
 */

/**
 * @typedef {object} ServerStatus  sent by the server once a second
 * @property {number | null} cell
 * @property {string} cell_name
 * @property {number} viewers_in_cell
 * @property {number} overlap  0 to 1
 * @property {number} texels_pending
 * @property {number} scene_revision
 * @property {number} fps
 * @property {number} mbit_per_s
 * @property {boolean} sky_converged
 * @property {PickedQuality | null} [quality]  null until the renderer has placed the viewer
 * @property {string | null} [renderer]  which renderer makes the frames
 * @property {string | null} [renderer_note]  why it is not the one that was asked for
 * @property {Stereo | null} [stereo]  the two eyes whose pictures frames hold
 * @property {string | null} [show_note]  why frames do not show the view that was asked for
 * @property {string | null} [loss_note]  what the view cell has lost because memory or time do not suffice
 * @property {"jpeg" | "png" | "h264" | "clouds"} [codec]  how frames are compressed
 * @property {number | null} [target_kbit_per_s]  the rate that a video aims at
 * @property {number | null} [cache_error_p50_percent]  how far half of the cached texels are from fresh ones at most
 * @property {number | null} [cache_error_p95_percent]  the same of 95 of 100
 */

/**
 * @typedef {object} Frame
 * @property {FrameHeader} header
 * @property {Uint8Array<ArrayBuffer>} payload  what `header.codec` says: a JPEG or PNG file, an access unit of H.264
 *   (video-decoder.js), or what clouds.js reads
 * @property {Camera | null} camera  the camera whose picture it is; null where it was asked for too long ago to know
 * @property {(times: { decode_us: number, present_us: number }) => void} presented  acknowledges; to be called once.
 *   decode_us: how long decoding took; present_us: when it was shown, µs since 1970
 */

/**
 * @typedef {object} ConnectionStatus
 * @property {"connecting" | "open" | "waiting" | "closed"} state  waiting: for the next try
 * @property {string} message  the state, for people
 * @property {number | null} retry_in_s  while waiting: until the next try
 * @property {string} problem  the server's last complaint, "" without one
 * @property {Welcome | null} welcome
 * @property {ServerStatus | null} server
 * @property {FrameHeader | null} header  of the newest frame
 * @property {number} fps  frames shown per second, over the last two seconds
 * @property {number} mbit_per_s  received, over the last two seconds
 * @property {number | null} latency_ms  from sending an input to showing the first frame with it, smoothed
 * @property {import("./latency.js").Percentiles | null} motion_to_photon_ms  the same of the latest inputs; null before the first
 * @property {import("./latency.js").Stages | null} stages  where the newest frame's time went
 * @property {number | null} frame_age_ms  from rendering a frame to showing it, by the two machines' clocks
 * @property {number} frames_received
 * @property {number} frames_presented
 * @property {number} reconnects
 */

/** The protocol's version and its WebSocket name. */
export const PROTOCOL = 1;
export const SUBPROTOCOL = "skycell.v1";

/** The server sends a status each second: this long without a word means that the line is dead. */
const SILENCE_LIMIT_MS = 8_000;
const RETRY_FIRST_MS = 500;
const RETRY_LONGEST_MS = 15_000;
/** A connection that breaks sooner than this does not count as a success, or a full server would be hammered. */
const STABLE_AFTER_MS = 5_000;
const RATE_WINDOW_MS = 2_000;
const STATUS_PERIOD_MS = 500;
const MAX_INPUTS_IN_FLIGHT = 256;
const MAX_FRAMES_IN_RATE_WINDOW = 512;
/** Of how many of the latest inputs percentiles are told. */
const MAX_MOTIONS = 256;
/** Above this the line cannot follow: the newest camera waits instead of joining a queue. */
const MAX_BUFFERED_BYTES = 16_384;

/**
 * How long to wait before a try: doubles up to 15 s; the upper half is random, so that a crowd does not return as one.
 *
 * @param {number} failures  in a row, at least 1
 * @param {number} random  0 to 1
 */
export function retryDelayMs(failures, random) {
  const longest_ms = Math.min(RETRY_LONGEST_MS, RETRY_FIRST_MS * 2 ** Math.min(failures - 1, 16));
  return longest_ms * (0.5 + 0.5 * random);
}

/**
 * After how long a server that closes wants this viewer back: it tells each another time, so that they do not come at once.
 *
 * @param {string} reason  of the close frame, such as "the server shuts down; retry_after_s=1.7"
 * @returns {number | null}  at most 15 s; null where it says nothing
 */
export function retryAfterMs(reason) {
  const told = /\bretry_after_s=(\d+(?:\.\d+)?)/.exec(reason);
  return told ? Math.min(RETRY_LONGEST_MS, Number(told[1]) * 1000) : null;
}

/** Wall clock in µs since 1970, finer than Date.now(). */
export function unixMicros() {
  return Math.round((performance.timeOrigin + performance.now()) * 1000);
}

const nextAnimationFrame = (/** @type {() => void} */ run) =>
  typeof requestAnimationFrame === "function" ? requestAnimationFrame(run) : setTimeout(run, 16);

/**
 * @param {string | URL} url  ws:// or wss://
 * @param {object} options
 * @param {View} options.view
 * @param {Camera} options.camera
 * @param {"cached" | "screen-space"} [options.renderer]
 * @param {Token} [options.token]  for a server that demands one
 */
export function connect(url, options) {
  return new Connection(url, options);
}

/** Made by {@link connect}. */
export class Connection {
  /** @type {WebSocket | null} */ #socket = null;
  /** @type {View} */ #view;
  /** @type {Camera} */ #camera;
  /** @type {Token | undefined} */ #token;
  /** @type {string | null} */ #token_sent = null;
  /** What the server last heard, as JSON. */ #camera_sent = "";
  #flush_scheduled = false;
  #last_input = 0;
  #input_shown = 0;
  /** When each input was sent, ms. @type {Map<number, number>} */ #inputs_in_flight = new Map();
  /** What each input looked at, from the one that is shown on. @type {Map<number, Camera>} */ #cameras = new Map();
  #failures = 0;
  #opened_ms = 0;
  #heard_ms = 0;
  #retry_ms = 0;
  /** @type {ReturnType<typeof setTimeout> | undefined} */ #retry_timer;
  /** @type {ReturnType<typeof setInterval>} */ #status_timer;
  /** @type {{ at_ms: number, bytes: number }[]} */ #received = [];
  /** When frames were shown, ms. @type {number[]} */ #shown = [];
  /** From sending inputs to showing them, ms. */ #motions = new RecentTimes(MAX_MOTIONS);
  /** @type {Set<(frame: Frame) => void>} */ #frame_handlers = new Set();
  /** @type {Set<(status: ConnectionStatus) => void>} */ #status_handlers = new Set();
  #listeners = new AbortController();
  /** @type {ConnectionStatus} */ #status = {
    state: "connecting",
    message: "Connecting…",
    retry_in_s: null,
    problem: "",
    welcome: null,
    server: null,
    header: null,
    fps: 0,
    mbit_per_s: 0,
    latency_ms: null,
    motion_to_photon_ms: null,
    stages: null,
    frame_age_ms: null,
    frames_received: 0,
    frames_presented: 0,
    reconnects: 0,
  };

  /**
   * @param {string | URL} url
   * @param {{ view: View, camera: Camera, renderer?: "cached" | "screen-space", token?: Token }} options
   */
  constructor(url, { view, camera, renderer, token }) {
    this.url = String(url);
    this.renderer = renderer;
    this.#token = token;
    this.#view = { ...view };
    this.#camera = { ...camera };
    this.#status_timer = setInterval(() => this.#tick(), STATUS_PERIOD_MS);
    const { signal } = this.#listeners;
    globalThis.addEventListener?.("online", () => this.retryNow(), { signal });
    globalThis.document?.addEventListener("visibilitychange", () => document.hidden || this.retryNow(), { signal });
    this.#open();
  }

  /** A copy of the newest figures. @returns {ConnectionStatus} */
  get status() {
    return { ...this.#status };
  }

  /**
   * Looks somewhere else. Sent once per animation frame at most, and only when it changed.
   * @param {Camera} camera
   */
  setCamera(camera) {
    this.#camera = { ...camera };
    this.#scheduleCamera();
  }

  /**
   * Wishes another size, rate, codec or quality.
   * @param {Partial<View>} wishes
   */
  setView(wishes) {
    const before = /** @type {Record<string, unknown>} */ ({ ...this.#view });
    const changed = Object.fromEntries(
      Object.entries(wishes).filter(([key, value]) => value !== undefined && value !== before[key]),
    );
    if (Object.keys(changed).length === 0) return;
    Object.assign(this.#view, changed);
    if (changed.codec !== undefined) delete this.#view.codecs;
    if (this.#status.state === "open") this.#send({ type: "view", ...changed });
  }

  /**
   * Called with every frame as it arrives. Returns a function that ends that.
   * @param {(frame: Frame) => void} handler
   */
  onFrame(handler) {
    this.#frame_handlers.add(handler);
    return () => this.#frame_handlers.delete(handler);
  }

  /**
   * Called twice a second and whenever the state changes. Returns a function that ends that.
   * @param {(status: ConnectionStatus) => void} handler
   */
  onStatus(handler) {
    this.#status_handlers.add(handler);
    handler(this.status);
    return () => this.#status_handlers.delete(handler);
  }

  /** The next picture is to need no earlier one: one of a video was lost. */
  requestKeyFrame() {
    if (this.#status.state === "open") this.#send({ type: "key_frame" });
  }

  /** Does not wait for the rest of the back-off. */
  retryNow() {
    if (this.#status.state === "waiting" && Number.isFinite(this.#retry_ms)) this.#open();
  }

  /** Ends the connection for good. */
  close() {
    this.#end("Closed.");
  }

  #open() {
    clearTimeout(this.#retry_timer);
    this.#heard_ms = performance.now();
    this.#change("connecting", this.#failures === 0 ? "Connecting…" : "Connecting again…");
    const socket = new WebSocket(this.url, SUBPROTOCOL);
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    socket.onopen = () => {
      const token = this.#token?.current() ?? null;
      this.#token_sent = token;
      this.#camera_sent = JSON.stringify(this.#camera);
      this.#cameras = new Map([[0, this.#camera]]);
      this.#send({
        type: "hello",
        protocol: PROTOCOL,
        ...this.#view,
        camera: this.#camera,
        ...(this.renderer && { renderer: this.renderer }),
        ...(token !== null && { token }),
      });
    };
    socket.onmessage = (event) => {
      this.#heard_ms = performance.now();
      try {
        if (typeof event.data === "string") this.#receiveText(JSON.parse(event.data));
        else this.#receiveBinary(event.data);
      } catch (error) {
        const reason = error instanceof Error ? error.message : String(error);
        // Text that is no JSON or a frame of another version: the two ends do not understand each other.
        if (error instanceof FrameError || error instanceof SyntaxError) this.#end(`Not understood: ${reason}`);
        else throw error;
      }
    };
    // `onerror` tells nothing that the `onclose` behind it does not.
    socket.onclose = (event) => this.#lost(socket, event.code, event.reason);
  }

  /** @param {any} message */
  #receiveText(message) {
    switch (message.type) {
      case "welcome":
        this.#status.welcome = message;
        this.#status.problem = "";
        this.#opened_ms = performance.now();
        this.#change("open", "Connected");
        this.#scheduleCamera();
        break;
      case "status":
        this.#status.server = message;
        this.#report();
        break;
      case "error":
        this.#status.problem = message.message;
        if (message.code === "wrong-protocol") {
          this.#end("The server speaks another version of the protocol: reload the page.");
        } else if (message.code === "unauthorized") {
          this.#refused(message.message);
        } else {
          this.#report();
        }
        break;
      default: // a newer server may say more than this page knows
    }
  }

  /** @param {ArrayBuffer} message */
  #receiveBinary(message) {
    const header = parseFrameHeader(message);
    const now_ms = performance.now();
    this.#received.push({ at_ms: now_ms, bytes: message.byteLength });
    if (this.#received.length > MAX_FRAMES_IN_RATE_WINDOW) this.#received.shift();
    if (header.heartbeat) return;
    this.#status.header = header;
    this.#status.frames_received += 1;
    const frame = {
      header,
      payload: new Uint8Array(message, message.byteLength - header.payload_bytes),
      camera: this.#cameraOf(header.input),
      presented: this.#presenter(header),
    };
    for (const handler of this.#frame_handlers) handler(frame);
  }

  /** @param {number} input */
  #cameraOf(input) {
    for (const older of this.#cameras.keys()) {
      if (older < input) this.#cameras.delete(older);
    }
    return this.#cameras.get(input) ?? null;
  }

  /**
   * @param {FrameHeader} header
   * @returns {Frame["presented"]}
   */
  #presenter(header) {
    const socket = this.#socket; // an acknowledgement must not reach the session after this one
    const received_us = unixMicros();
    return ({ decode_us, present_us }) => {
      if (socket !== this.#socket || this.#status.state !== "open") return;
      const now_ms = performance.now();
      const motion_ms = this.#measureLatency(header.input, now_ms);
      this.#send({
        type: "ack",
        sequence: header.sequence,
        decode_us: Math.max(0, Math.round(decode_us)),
        received_us,
        present_us: Math.max(0, Math.round(present_us)),
        ...(motion_ms !== null && { motion_to_photon_us: Math.round(motion_ms * 1000) }),
      });
      this.#status.stages = stagesOf(header, { received_us, decode_us, present_us });
      this.#status.frames_presented += 1;
      this.#shown.push(now_ms);
      if (this.#shown.length > MAX_FRAMES_IN_RATE_WINDOW) this.#shown.shift();
      this.#status.frame_age_ms = (present_us - header.render_unix_us) / 1000;
    };
  }

  /**
   * @param {number} input
   * @param {number} now_ms
   * @returns {number | null}  how long ago the input was sent, if it is shown for the first time
   */
  #measureLatency(input, now_ms) {
    if (input <= this.#input_shown) return null;
    this.#input_shown = input;
    const sent_ms = this.#inputs_in_flight.get(input);
    for (const older of this.#inputs_in_flight.keys()) {
      if (older <= input) this.#inputs_in_flight.delete(older);
    }
    if (sent_ms === undefined) return null;
    const motion_ms = now_ms - sent_ms;
    const before_ms = this.#status.latency_ms ?? motion_ms;
    this.#status.latency_ms = before_ms + 0.3 * (motion_ms - before_ms);
    this.#motions.push(motion_ms);
    return motion_ms;
  }

  #scheduleCamera() {
    if (this.#flush_scheduled) return;
    this.#flush_scheduled = true;
    nextAnimationFrame(() => {
      this.#flush_scheduled = false;
      this.#flushCamera();
    });
  }

  #flushCamera() {
    if (this.#status.state !== "open" || !this.#socket) return; // hello will say it
    const camera = JSON.stringify(this.#camera);
    if (camera === this.#camera_sent) return;
    if (this.#socket.bufferedAmount > MAX_BUFFERED_BYTES) {
      this.#scheduleCamera();
      return;
    }
    this.#camera_sent = camera;
    this.#last_input += 1;
    this.#inputs_in_flight.set(this.#last_input, performance.now());
    this.#cameras.set(this.#last_input, this.#camera);
    for (const inputs of [this.#inputs_in_flight, this.#cameras]) {
      const [oldest] = inputs.keys();
      if (inputs.size > MAX_INPUTS_IN_FLIGHT && oldest !== undefined) inputs.delete(oldest);
    }
    this.#send({ type: "camera", input: this.#last_input, camera: this.#camera });
  }

  /** @param {object} message */
  #send(message) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(JSON.stringify(message));
  }

  /**
   * @param {WebSocket} socket
   * @param {number} code
   * @param {string} reason
   */
  #lost(socket, code, reason) {
    if (socket !== this.#socket || this.#status.state === "closed") return;
    const was_stable = this.#opened_ms > 0 && performance.now() - this.#opened_ms > STABLE_AFTER_MS;
    const was_open = this.#status.state === "open";
    this.#failures = was_stable ? 1 : this.#failures + 1;
    this.#forgetSession();
    this.#status.reconnects += 1;
    if (reason && !this.#status.problem) this.#status.problem = `${reason} (${code})`;
    const delay_ms = retryAfterMs(reason) ?? retryDelayMs(this.#failures, Math.random());
    this.#retry_ms = performance.now() + delay_ms;
    this.#change("waiting", was_open ? "Connection lost, trying again" : "No connection, trying again");
    this.#retry_timer = setTimeout(() => this.#open(), delay_ms);
  }

  /**
   * Without another token there is nothing to try again.
   * @param {string} why
   */
  #refused(why) {
    const socket = this.#socket;
    this.#forgetSession(); // its close is no loss that a retry would mend
    socket?.close(1000);
    this.#retry_ms = Number.POSITIVE_INFINITY;
    this.#status.problem = ""; // it is asked for, so nothing is wrong yet
    this.#change("waiting", "Waiting for a token");
    void (async () => {
      const has_another = await this.#token?.refused(this.#token_sent);
      if (this.#status.state !== "waiting" || this.#socket) return;
      if (has_another) this.#open();
      else this.#end(`Not let in: ${why}`);
    })();
  }

  #forgetSession() {
    this.#socket = null;
    this.#opened_ms = 0;
    this.#inputs_in_flight.clear();
    this.#received.length = 0;
    this.#shown.length = 0;
    this.#motions.clear();
    Object.assign(this.#status, {
      server: null,
      latency_ms: null,
      motion_to_photon_ms: null,
      stages: null,
      frame_age_ms: null,
      fps: 0,
      mbit_per_s: 0,
    });
  }

  /** @param {string} message */
  #end(message) {
    const socket = this.#socket;
    clearTimeout(this.#retry_timer);
    clearInterval(this.#status_timer);
    this.#listeners.abort();
    this.#forgetSession();
    this.#change("closed", message);
    socket?.close(1000);
  }

  #tick() {
    const now_ms = performance.now();
    if (this.#socket && now_ms - this.#heard_ms > SILENCE_LIMIT_MS) {
      const silent = this.#socket;
      silent.onclose = null; // a dead line may take minutes to say so
      silent.close();
      this.#lost(silent, 1006, "");
      return;
    }
    this.#report();
  }

  #report() {
    const since_ms = performance.now() - RATE_WINDOW_MS;
    this.#received = this.#received.filter(({ at_ms }) => at_ms > since_ms);
    this.#shown = this.#shown.filter((at_ms) => at_ms > since_ms);
    const bytes = this.#received.reduce((sum, { bytes }) => sum + bytes, 0);
    this.#status.motion_to_photon_ms = this.#motions.percentiles();
    this.#status.fps = this.#shown.length / (RATE_WINDOW_MS / 1000);
    this.#status.mbit_per_s = (bytes * 8) / 1e6 / (RATE_WINDOW_MS / 1000);
    if (this.#status.state === "waiting" && Number.isFinite(this.#retry_ms)) {
      this.#status.retry_in_s = Math.max(0, Math.ceil((this.#retry_ms - performance.now()) / 1000));
    }
    for (const handler of this.#status_handlers) handler(this.status);
  }

  /**
   * @param {ConnectionStatus["state"]} state
   * @param {string} message
   */
  #change(state, message) {
    this.#status.state = state;
    this.#status.message = message;
    this.#status.retry_in_s = null;
    this.#report();
  }
}
