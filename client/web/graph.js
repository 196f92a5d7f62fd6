// @ts-check
/**
 * A small graph of the last minute: latency and rate, and where the newest frame's time went.
 */

/** @typedef {import("./connection.js").ConnectionStatus} ConnectionStatus */
/** @typedef {import("./frame-header.js").FrameHeader} FrameHeader */

/**
 * @typedef {object} Sample
 * @property {number} at_ms
 * @property {number | null} latency_ms
 * @property {number | null} motion_ms
 * @property {number} mbit_per_s
 */

const SPAN_MS = 60_000;
const SAMPLES_MAX = 240;
const COLOURS = { latency: "#ffc45c", motion: "#7ee2a0", rate: "#7db7ff" };
const GRID = "rgb(255 255 255 / 14%)";
const INK = "#dfe7f2";

/** Stages of a frame in the order of its way, by the header's fields. */
const STAGES = /** @type {[string, keyof FrameHeader | string, string][]} */ ([
  ["wait for marching", "march_wait_us", "#b48cf0"],
  ["composite", "composite_us", "#7db7ff"],
  ["read back", "readback_us", "#59c9d6"],
  ["wait for an encoder", "encode_wait_us", "#8a97a8"],
  ["encode", "encode_us", "#7ee2a0"],
  ["wait for the socket", "encode_to_send_us", "#ffc45c"],
]);

/**
 * Stages of a frame that its header tells, ms.
 * @param {FrameHeader | null} header
 * @returns {{ name: string, ms: number, colour: string }[]}
 */
export function stagesOf(header) {
  if (!header) return [];
  const fields = /** @type {Record<string, unknown>} */ (/** @type {unknown} */ (header));
  return STAGES.flatMap(([name, field, colour]) => {
    const us = fields[field];
    return typeof us === "number" ? [{ name, ms: us / 1000, colour }] : [];
  });
}

/**
 * The next of 1, 2 and 5 times a power of ten that is not smaller.
 * @param {number} value
 */
export function roundUp(value) {
  if (!(value > 0)) return 1;
  const decade = 10 ** Math.floor(Math.log10(value));
  return ([1, 2, 5, 10].find((times) => times * decade >= value * (1 - 1e-9)) ?? 10) * decade;
}

/**
 * @param {object} parts
 * @param {HTMLElement} parts.panel
 * @param {HTMLCanvasElement} parts.canvas
 * @param {HTMLElement} parts.stages
 * @param {HTMLButtonElement} parts.opener
 * @param {() => number | null} parts.motionMs
 */
export function attachGraph({ panel, canvas, stages, opener, motionMs }) {
  /** @type {Sample[]} */
  let samples = [];

  const draw = () => {
    const { clientWidth: width, clientHeight: height } = canvas;
    const scale = devicePixelRatio || 1;
    const context = canvas.getContext("2d");
    if (!context || width === 0) return;
    canvas.width = Math.round(width * scale);
    canvas.height = Math.round(height * scale);
    context.setTransform(scale, 0, 0, scale, 0, 0);
    const now_ms = performance.now();
    const top_ms = roundUp(Math.max(50, ...samples.map(({ latency_ms, motion_ms }) => Math.max(latency_ms ?? 0, motion_ms ?? 0))));
    const top_mbit = roundUp(Math.max(1, ...samples.map(({ mbit_per_s }) => mbit_per_s)));
    const bottom = height - 4;
    const x = (/** @type {number} */ at_ms) => width - ((now_ms - at_ms) / SPAN_MS) * width;
    const y = (/** @type {number} */ share) => bottom - share * (bottom - 16);
    context.strokeStyle = GRID;
    for (const share of [0, 0.5, 1]) {
      context.beginPath();
      context.moveTo(0, Math.round(y(share)) + 0.5);
      context.lineTo(width, Math.round(y(share)) + 0.5);
      context.stroke();
    }
    /** @type {[string, (sample: Sample) => number | null, number][]} */
    const curves = [
      [COLOURS.rate, ({ mbit_per_s }) => mbit_per_s, top_mbit],
      [COLOURS.motion, ({ motion_ms }) => motion_ms, top_ms],
      [COLOURS.latency, ({ latency_ms }) => latency_ms, top_ms],
    ];
    context.lineWidth = 1.6;
    for (const [colour, value, top] of curves) {
      context.strokeStyle = colour;
      context.beginPath();
      let drawn = false;
      for (const sample of samples) {
        const at = value(sample);
        if (at === null) drawn = false;
        else if (drawn) context.lineTo(x(sample.at_ms), y(at / top));
        else context.moveTo(x(sample.at_ms), y(at / top));
        drawn = at !== null;
      }
      context.stroke();
    }
    context.font = "11px system-ui, 'DejaVu Sans', sans-serif";
    context.fillStyle = INK;
    context.textAlign = "left";
    context.fillText(`${top_ms} ms`, 2, 11);
    context.textAlign = "right";
    context.fillText(`${top_mbit} Mbit/s`, width - 2, 11);
  };

  const drawStages = (/** @type {FrameHeader | null} */ header) => {
    const found = stagesOf(header);
    stages.hidden = found.length === 0;
    stages.replaceChildren(
      ...found.map(({ name, ms, colour }) => {
        const item = document.createElement("li");
        item.style.setProperty("--colour", colour);
        item.textContent = `${name} ${ms.toFixed(1)} ms`;
        return item;
      }),
    );
  };

  opener.addEventListener("click", () => {
    panel.hidden = !panel.hidden;
    opener.setAttribute("aria-expanded", String(!panel.hidden));
    if (!panel.hidden) draw();
  });

  return {
    /** @param {ConnectionStatus} status */
    add({ latency_ms, mbit_per_s, header }) {
      const at_ms = performance.now();
      samples.push({ at_ms, latency_ms, motion_ms: motionMs(), mbit_per_s });
      samples = samples.filter((sample) => at_ms - sample.at_ms < SPAN_MS).slice(-SAMPLES_MAX);
      if (panel.hidden) return;
      draw();
      drawStages(header);
    },
    samples: () => samples,
  };
}
