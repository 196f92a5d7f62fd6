// @ts-check
/**
 * The sky's clock and its presets: what the page shows of them and asks the server for.
 */

import { watchEvents } from "./events.js";

/**
 * @typedef {object} SkyTime
 * @property {number} revision
 * @property {string} now  moment of the report
 * @property {number} sky_s
 * @property {string | null} date  at the sun's place, UTC
 * @property {number | null} longitude_deg
 * @property {number} rate
 * @property {number} wind_rate
 * @property {boolean} paused
 * @property {{ azimuth_deg: number, elevation_deg: number }} sun
 */

/**
 * @typedef {object} Preset
 * @property {string} name
 * @property {string} title
 * @property {string} about
 * @property {import("./look.js").Camera} camera
 */

const HOUR_S = 3600;
const DAY_S = 24 * HOUR_S;

/**
 * Sky time some seconds after a report.
 * @param {SkyTime} report
 * @param {number} later_s
 */
export function skySecondsAfter(report, later_s) {
  return report.sky_s + (report.paused ? 0 : report.rate * later_s);
}

/**
 * Mean solar hour of the sun's place, 0 to 24; null where the sun stands by hand.
 * @param {SkyTime} report
 * @param {number} later_s
 */
export function localHour(report, later_s) {
  if (report.date === null || report.longitude_deg === null) return null;
  const date_s = Date.parse(report.date) / 1000 + skySecondsAfter(report, later_s) - report.sky_s;
  const local_s = date_s + (report.longitude_deg / 360) * DAY_S;
  return (((local_s % DAY_S) + DAY_S) % DAY_S) / HOUR_S;
}

/**
 * Sky time at which the local hour of the same day is another one.
 * @param {SkyTime} report
 * @param {number} later_s
 * @param {number} hour
 */
export function skySecondsAtHour(report, later_s, hour) {
  const now = localHour(report, later_s);
  return skySecondsAfter(report, later_s) + (now === null ? 0 : (hour - now) * HOUR_S);
}

/**
 * 6.5 as 06:30.
 * @param {number} hour
 */
export function clockText(hour) {
  const minutes = Math.floor(hour * 60 + 1e-6);
  return `${String(Math.floor(minutes / 60) % 24).padStart(2, "0")}:${String(minutes % 60).padStart(2, "0")}`;
}

/**
 * Seconds as 1 d 02:03:04.
 * @param {number} sky_s
 */
export function skyTimeText(sky_s) {
  const whole = Math.floor(Math.abs(sky_s));
  const part = (/** @type {number} */ value) => String(value).padStart(2, "0");
  const days = Math.floor(whole / DAY_S);
  const time = `${part(Math.floor(whole / HOUR_S) % 24)}:${part(Math.floor(whole / 60) % 60)}:${part(whole % 60)}`;
  return `${sky_s <= -1 ? "−" : ""}${days > 0 ? `${days} d ` : ""}${time}`;
}

/**
 * What a server answers to a request about its sky.
 * @param {string} path  under api/v1
 * @param {string} [method]
 * @param {unknown} [body]
 */
async function ask(path, method = "GET", body) {
  const is_patch = method === "PATCH";
  const answer = await fetch(new URL(`api/v1/${path}`, location.href), {
    method,
    headers:
      body === undefined
        ? {}
        : { "Content-Type": is_patch ? "application/merge-patch+json" : "application/json", "If-Match": "*" },
    ...(body === undefined ? {} : { body: JSON.stringify(body) }),
  });
  const value = await answer.json();
  if (!answer.ok) throw new Error(typeof value.detail === "string" ? value.detail : answer.statusText);
  return value;
}

/** @returns {Promise<Preset[]>} */
export const listPresets = () => ask("presets");

/**
 * @param {string} name
 * @param {number} transition_s
 */
export const setPreset = (name, transition_s) => ask("scene/preset", "POST", { name, transition_s });

/**
 * @param {object} change  sky_s, date, rate, wind_rate or paused
 * @param {string} [group]  of changes that are one to whoever looks back
 * @returns {Promise<SkyTime>}
 */
export const changeTime = (change, group) => ask(`scene/time${group ? `?group=${group}` : ""}`, "PUT", change);

/** @param {object} patch */
export const patchScene = (patch) => ask("scene", "PATCH", patch);

/**
 * Tells of the sky's clock now and at every change of the scene.
 * @param {(report: SkyTime) => void} onReport
 * @param {() => void} onGap  changes were missed that nobody knows any more: the scene is to be read anew
 */
export function watchSky(onReport, onGap) {
  return watchEvents(new URL("api/v1/scene/events", location.href), (name, data) => {
    if (name === "scene") onReport(JSON.parse(data));
    else if (name === "gap") onGap();
  });
}

const DEG = Math.PI / 180;
/** The sun's upper edge on the horizon, with refraction. */
const RISE_ELEVATION_DEG = -0.833;

/**
 * Mean solar hours at which the sun rises, stands highest and sets (U.S. Naval Observatory's low-precision formulas, some
 * minutes off), for the bar of the day. rise and set are null where it does neither that day.
 * @param {Date} date
 * @param {number} latitude_deg
 * @returns {{ rise: number | null, noon: number, set: number | null, always: "" | "day" | "night" }}
 */
export function sunHours(date, latitude_deg) {
  const days = date.getTime() / 86_400_000 - 10_957.5; // since noon of 1 January 2000
  const mean_deg = (357.529 + 0.98560028 * days) % 360;
  const longitude_deg = 280.459 + 0.98564736 * days;
  const ecliptic_deg = longitude_deg + 1.915 * Math.sin(mean_deg * DEG) + 0.02 * Math.sin(2 * mean_deg * DEG);
  const obliquity_deg = 23.439 - 0.00000036 * days;
  const declination_rad = Math.asin(Math.sin(obliquity_deg * DEG) * Math.sin(ecliptic_deg * DEG));
  const ascension_deg =
    Math.atan2(Math.cos(obliquity_deg * DEG) * Math.sin(ecliptic_deg * DEG), Math.cos(ecliptic_deg * DEG)) / DEG;
  const equation_deg = ((((longitude_deg - ascension_deg + 180) % 360) + 360) % 360) - 180;
  const noon = 12 - equation_deg / 15;
  const latitude_rad = latitude_deg * DEG;
  const cosine =
    (Math.sin(RISE_ELEVATION_DEG * DEG) - Math.sin(latitude_rad) * Math.sin(declination_rad)) /
    Math.max(Math.cos(latitude_rad) * Math.cos(declination_rad), 1e-9);
  if (cosine >= 1) return { rise: null, noon, set: null, always: "night" };
  if (cosine <= -1) return { rise: null, noon, set: null, always: "day" };
  const half = Math.acos(cosine) / DEG / 15;
  return { rise: noon - half, noon, set: noon + half, always: "" };
}
