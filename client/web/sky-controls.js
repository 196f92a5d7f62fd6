// @ts-check
/** The page's controls of the sky: presets, pause, pace and the bar of the day. */

import { showPresets } from "./presets.js";
import { newGroup } from "./scene-edit.js";
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
  sunHours,
  watchSky,
} from "./sky.js";

/** @typedef {import("./sky.js").SkyTime} SkyTime */
/** @typedef {import("./sky.js").Preset} Preset */

/** A slider that is dragged asks this often at most. */
const SLIDE_INTERVAL_MS = 250;
const SHOW_INTERVAL_MS = 500;
/** Where the sun's place is not known: the protocol's default. */
const LATITUDE_DEG = 48.2;

/**
 * @typedef {object} SkyElements
 * @property {HTMLSelectElement} preset
 * @property {HTMLElement} gallery
 * @property {HTMLSelectElement} transition
 * @property {HTMLButtonElement} pause
 * @property {HTMLSelectElement} pace
 * @property {HTMLElement} day
 * @property {HTMLInputElement} hour
 * @property {HTMLElement} hour_text
 * @property {HTMLButtonElement[]} marks  dawn, noon, dusk
 * @property {HTMLElement} sky_time
 */

/**
 * @param {SkyElements} elements
 * @param {object} hooks
 * @param {(camera: import("./look.js").Camera) => void} hooks.onCamera  a preset suggests where to look
 * @param {(text: string) => void} hooks.onProblem
 * @param {(presets: Preset[]) => void} hooks.onPresets
 * @param {(preset: Preset) => void} hooks.onPreset  before it is asked for
 * @param {(report: SkyTime) => void} hooks.onReport
 * @param {() => void} hooks.onGap  the scene is to be read anew
 * @param {() => void} hooks.onStep  the clock is about to be changed: what is now is what an undo brings back
 * @param {() => number | null} hooks.latitude  of the sun's place, degrees
 */
export function attachSkyControls(elements, hooks) {
  const { preset, gallery, transition, pause, pace, day, hour, hour_text, marks, sky_time } = elements;
  /** @type {SkyTime | null} */
  let report = null;
  let reported_ms = 0;
  /** @type {Preset[]} */
  let presets = [];
  let cards = { mark: (/** @type {string | null} */ _name) => {} };
  let sliding = false;
  let slid_ms = 0;
  /** Names the changes of one movement of the slider to the server. */
  let group = "";
  /** @type {[number | null, number, number | null]} */
  let mark_hours = [6, 12, 18];

  const laterSeconds = () => (performance.now() - reported_ms) / 1000;

  const showDay = () => {
    const date = new Date(report?.date ?? "2026-03-20T12:00:00Z");
    const { rise, noon, set, always } = sunHours(date, hooks.latitude() ?? LATITUDE_DEG);
    mark_hours = [rise, noon, set];
    for (const [index, name] of ["--dawn", "--noon", "--dusk"].entries()) {
      const at = mark_hours[index];
      marks[index].hidden = at === null;
      if (at !== null) day.style.setProperty(name, `${((at / 24) * 100).toFixed(2)}%`);
      marks[index].title = at === null ? "" : clockText(Math.max(0, at));
    }
    day.classList.toggle("always-day", always === "day");
    day.classList.toggle("always-night", always === "night");
    day.classList.toggle("by-hand", !report || report.date === null);
  };

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
    const text = local === null && !sliding ? "by hand" : clockText(sliding || local === null ? Number(hour.value) : local);
    if (hour_text.textContent !== text) hour_text.textContent = text;
    hour.setAttribute("aria-valuetext", text === "by hand" ? "the sun stands by hand" : text);
  };

  const attempt = async (/** @type {() => Promise<unknown>} */ action) => {
    try {
      await action();
      hooks.onProblem("");
    } catch (error) {
      hooks.onProblem(error instanceof Error ? error.message : String(error));
    }
  };

  /** @param {SkyTime} changed */
  const take = (changed) => {
    report = changed;
    reported_ms = performance.now();
    hooks.onReport(changed);
  };
  const beginSlide = () => {
    if (sliding) return;
    sliding = true;
    group = newGroup();
    hooks.onStep();
  };
  const slide = async () => {
    if (!report) return;
    slid_ms = performance.now();
    const wanted = Number(hour.value);
    if (report.date === null) {
      // The sun stands by hand: from now on it stands by the clock.
      await patchScene({ sun: { place_and_time: {} } });
      take(await changeTime({}));
    }
    take(await changeTime({ sky_s: skySecondsAtHour(report, laterSeconds(), wanted) }, group));
  };

  /** @param {object} wanted */
  const setClock = (wanted) =>
    attempt(async () => {
      hooks.onStep();
      take(await changeTime(wanted));
    });
  const togglePause = () => setClock({ paused: !report?.paused });
  const settle = () =>
    attempt(async () => {
      try {
        await slide();
      } finally {
        sliding = false;
      }
    });
  pause.addEventListener("click", togglePause);
  pace.addEventListener("change", () =>
    // Clouds keep their pace while days fly by.
    setClock({ rate: Number(pace.value), wind_rate: pace.value === "1" ? null : 1 }),
  );
  hour.addEventListener("input", () => {
    beginSlide();
    show();
    if (performance.now() - slid_ms > SLIDE_INTERVAL_MS) void attempt(slide);
  });
  hour.addEventListener("change", settle);
  for (const [index, mark] of marks.entries()) {
    mark.addEventListener("click", () => {
      beginSlide();
      hour.value = String(mark_hours[index] ?? 12);
      void settle();
    });
  }

  const choose = (/** @type {Preset} */ chosen) => {
    preset.value = chosen.name;
    preset.title = chosen.about;
    cards.mark(chosen.name);
    hooks.onPreset(chosen);
    hooks.onCamera(chosen.camera);
    void attempt(() => setPreset(chosen.name, Number(transition.value)));
  };
  preset.addEventListener("change", () => {
    const chosen = presets.find(({ name }) => name === preset.value);
    if (chosen) choose(chosen);
  });

  void attempt(async () => {
    presets = await listPresets();
    for (const { name, title } of presets) preset.add(new Option(title, name));
    cards = showPresets(gallery, presets, choose);
    hooks.onPresets(presets);
  });
  watchSky((next) => {
    report = next;
    reported_ms = performance.now();
    hooks.onReport(next);
    showDay();
    show();
  }, hooks.onGap);
  showDay();
  setInterval(show, SHOW_INTERVAL_MS);
  return { togglePause, showDay };
}
