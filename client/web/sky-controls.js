// @ts-check
/** The page's controls of the sky: presets, pause, pace and hour. */

import {
  changeTime,
  clockText,
  listPresets,
  localHour,
  patchScene,
  setPreset,
  skySecondsAfter,
  skySecondsAtHour,
  skyTimeText,
  watchSky,
} from "./sky.js";

/** @typedef {import("./sky.js").SkyTime} SkyTime */

/** A slider that is dragged asks this often at most. */
const SLIDE_INTERVAL_MS = 250;
const SHOW_INTERVAL_MS = 500;

/**
 * @typedef {object} SkyElements
 * @property {HTMLSelectElement} preset
 * @property {HTMLSelectElement} transition
 * @property {HTMLButtonElement} pause
 * @property {HTMLSelectElement} pace
 * @property {HTMLInputElement} hour
 * @property {HTMLElement} hour_text
 * @property {HTMLElement} sky_time
 */

/**
 * @param {SkyElements} elements
 * @param {object} hooks
 * @param {(camera: import("./look.js").Camera) => void} hooks.onCamera  a preset suggests where to look
 * @param {(text: string) => void} hooks.onProblem
 */
export function attachSkyControls(elements, { onCamera, onProblem }) {
  const { preset, transition, pause, pace, hour, hour_text, sky_time } = elements;
  /** @type {SkyTime | null} */
  let report = null;
  let reported_ms = 0;
  /** @type {import("./sky.js").Preset[]} */
  let presets = [];
  let sliding = false;
  let slid_ms = 0;

  const laterSeconds = () => (performance.now() - reported_ms) / 1000;

  const show = () => {
    if (!report) return;
    sky_time.textContent = skyTimeText(skySecondsAfter(report, laterSeconds()));
    pause.textContent = report.paused ? "Resume" : "Pause";
    pause.setAttribute("aria-pressed", String(report.paused));
    const wanted = String(report.rate);
    if (![...pace.options].some(({ value }) => value === wanted)) pace.add(new Option(`${wanted} ×`, wanted));
    if (document.activeElement !== pace) pace.value = wanted;
    const local = localHour(report, laterSeconds());
    if (!sliding) hour.value = String(local ?? 12);
    hour_text.textContent = local === null ? "by hand" : clockText(sliding ? Number(hour.value) : local);
  };

  const attempt = async (/** @type {() => Promise<unknown>} */ action) => {
    try {
      await action();
      onProblem("");
    } catch (error) {
      onProblem(error instanceof Error ? error.message : String(error));
    }
  };

  const slide = async () => {
    if (!report) return;
    slid_ms = performance.now();
    const wanted = Number(hour.value);
    if (report.date === null) {
      // The sun stands by hand: from now on it stands by the clock.
      await patchScene({ sun: { place_and_time: {} } });
      report = await changeTime({});
      reported_ms = performance.now();
    }
    await changeTime({ sky_s: skySecondsAtHour(report, laterSeconds(), wanted) });
  };

  pause.addEventListener("click", () => attempt(() => changeTime({ paused: !report?.paused })));
  pace.addEventListener("change", () =>
    // Clouds keep their pace while days fly by.
    attempt(() => changeTime({ rate: Number(pace.value), wind_rate: pace.value === "1" ? null : 1 })),
  );
  hour.addEventListener("input", () => {
    sliding = true;
    show();
    if (performance.now() - slid_ms > SLIDE_INTERVAL_MS) void attempt(slide);
  });
  hour.addEventListener("change", () =>
    attempt(async () => {
      await slide();
      sliding = false;
    }),
  );
  preset.addEventListener("change", () => {
    const chosen = presets.find(({ name }) => name === preset.value);
    if (!chosen) return;
    preset.title = chosen.about;
    onCamera(chosen.camera);
    void attempt(() => setPreset(chosen.name, Number(transition.value)));
  });

  void attempt(async () => {
    presets = await listPresets();
    for (const { name, title } of presets) preset.add(new Option(title, name));
  });
  watchSky((next) => {
    report = next;
    reported_ms = performance.now();
    show();
  });
  setInterval(show, SHOW_INTERVAL_MS);
}
