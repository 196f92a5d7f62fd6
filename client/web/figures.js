// @ts-check
/** The figures of a connection, as the page writes them. */

import { write } from "./dom.js";

/** @typedef {import("./connection.js").ConnectionStatus} ConnectionStatus */
/** @typedef {import("./connection.js").ServerStatus} ServerStatus */

const compact = new Intl.NumberFormat("en", { notation: "compact", maximumSignificantDigits: 3 });

/** @param {ServerStatus} server */
function texelsText({ texels_pending, sky_converged }) {
  if (texels_pending > 0) return `${compact.format(texels_pending)} pending`;
  return sky_converged ? "converged" : "none pending";
}

/** @param {ServerStatus} server */
function cacheErrorText({ cache_error_p50_percent: p50, cache_error_p95_percent: p95 }) {
  if (typeof p50 !== "number" || typeof p95 !== "number") return "–";
  return `p50 ${p50.toFixed(1)} % p95 ${p95.toFixed(1)} %`;
}

/** @param {ServerStatus} server */
function pickedText({ quality }) {
  if (!quality) return "–";
  const flip = `FLIP ${quality.measured ? "" : "about "}${quality.flip.toFixed(3)}`;
  const time = typeof quality.device_ms === "number" ? ` · ${quality.device_ms.toFixed(1)} ms` : "";
  return `${quality.name} · ${flip}${time}${quality.is_met ? "" : " · not as asked"}`;
}

/**
 * @param {import("./connection.js").FrameHeader} header
 * @param {{ width: number, height: number } | null} shown  where it is not the frame's own size
 */
function sizeText({ width, height, stereo, coarse }, shown) {
  const size = stereo ? `2 × ${width / 2} × ${height}` : shown ? `${shown.width} × ${shown.height}` : `${width} × ${height}`;
  return coarse ? `${size}, still coarse` : size;
}

const CODEC_NAMES = { h264: "H.264", jpeg: "JPEG", png: "PNG", clouds: "clouds alone" };

/** @param {ConnectionStatus} status */
function codecText({ server, welcome, header }) {
  const codec = server?.codec ?? welcome?.codec;
  if (!codec) return "–";
  const rate = server?.target_kbit_per_s;
  const aim = typeof rate === "number" ? `, ${(rate / 1000).toFixed(1)} Mbit/s at most` : "";
  return `${CODEC_NAMES[codec]}${aim}${header?.exact && header.codec === "png" ? ", now exact" : ""}`;
}

/** @param {number | null} ms */
const milliseconds = (ms) => (ms === null ? "–" : `${ms.toFixed(ms < 9.95 ? 1 : 0)} ms`);

/**
 * @param {ConnectionStatus} status
 * @param {{ width: number, height: number } | null} shown
 * @param {number | null} motion_ms
 * @param {string} video_problem  why a video is not shown as one; "" without a reason
 */
export function showFigures(status, shown, motion_ms, video_problem) {
  const { server, header, fps, mbit_per_s, latency_ms, frame_age_ms } = status;
  const at_rest = status.state === "open" && fps === 0 && header !== null;
  write("fps", at_rest ? "at rest" : fps.toFixed(fps < 9.95 ? 1 : 0));
  write("rate", `${mbit_per_s.toFixed(mbit_per_s < 9.95 ? 2 : 1)} Mbit/s`);
  write("latency", latency_ms === null ? "–" : `${latency_ms.toFixed(0)} ms`);
  write("motion", milliseconds(motion_ms));
  // By two clocks: an age below zero or of minutes says that they differ, not how old the frame is.
  const age_known = frame_age_ms !== null && frame_age_ms >= 0 && frame_age_ms < 60_000;
  write("age", age_known ? `${frame_age_ms.toFixed(0)} ms` : "–");
  write("cell", server && server.cell !== null ? server.cell_name || `cell ${server.cell}` : "–");
  write("viewers", server ? String(server.viewers_in_cell) : "–");
  write("overlap", server ? `${(server.overlap * 100).toFixed(0)} %` : "–");
  write("texels", server ? texelsText(server) : "–");
  write("picked", server ? pickedText(server) : "–");
  write("cache-error", server ? cacheErrorText(server) : "–");
  write("renderer", server?.renderer ?? "–");
  write("codec", codecText(status));
  const notes = [server?.show_note ?? server?.renderer_note, server?.loss_note, video_problem];
  write("show-note", notes.filter((note) => note).join("; "));
  write("picture-size", header ? sizeText(header, shown) : "–");
}
