// @ts-check
/** The tab of the scene: panel, undo and reset. */

import { element } from "./dom.js";
import { refusal } from "./maps.js";
import { SceneEditor } from "./scene-edit.js";
import { createScenePanel } from "./scene-panel.js";

/**
 * @param {string} path
 * @returns {Promise<any>}
 */
async function read(path) {
  const response = await fetch(path);
  if (!response.ok) throw new Error(await refusal(response));
  return response.json();
}

/**
 * @param {object} hooks
 * @param {(text: string) => void} hooks.onProblem
 * @param {() => void} hooks.onDocument  the document is another one
 */
export function attachScene({ onProblem, onDocument }) {
  const told = element("scene-told", HTMLElement);
  const undo = element("undo", HTMLButtonElement);
  const reset = element("reset", HTMLButtonElement);
  const reset_to = element("reset-to", HTMLSelectElement);

  /** @param {string} text @param {boolean} bad */
  const tell = (text, bad) => {
    if (told.textContent !== text) told.textContent = text;
    told.classList.toggle("problem", bad);
    onProblem(bad ? text : "");
  };
  const attempt = async (/** @type {() => Promise<unknown>} */ action) => {
    try {
      await action();
    } catch (error) {
      tell(error instanceof Error ? error.message : String(error), true);
    }
  };

  const editor = new SceneEditor(tell);
  /** The scene that values are reset to; null: the defaults. @type {any} */
  let reference = null;
  const panel = createScenePanel({
    container: element("scene-panel", HTMLElement),
    editor,
    reference: () => reference,
    onShown: () => {},
  });
  editor.onChange(({ can_undo }) => {
    undo.disabled = !can_undo;
    onDocument();
  });

  const setReference = async (/** @type {string} */ name) => {
    reset_to.value = name;
    reference = name === "" ? null : (await read(`api/v1/presets/${encodeURIComponent(name)}`)).scene;
    panel.refresh();
  };
  reset_to.addEventListener("change", () => attempt(() => setReference(reset_to.value)));
  reset.addEventListener("click", () =>
    attempt(async () => {
      if (reference === null) await editor.reset();
      else await editor.replace(reference);
    }),
  );
  const takeBack = () => attempt(() => editor.undo());
  undo.addEventListener("click", takeBack);

  void attempt(() => editor.load());
  let described = false;

  return {
    editor,
    /** Somebody looks at the tab: what the fields are is asked for once. */
    describe: () => {
      if (described) return;
      described = true;
      void attempt(async () => panel.describe(await read("api/v1/openapi.json"))).then(() => {
        described = panel.isDescribed();
      });
    },
    undo: takeBack,
    reload: () => attempt(() => editor.load()),
    /** @param {number} revision */
    sawRevision: (revision) => attempt(() => editor.load(revision)),
    /** @param {import("./sky.js").Preset[]} presets */
    setPresets: (presets) => {
      for (const { name, title } of presets) reset_to.add(new Option(title, name));
    },
    /** A preset is about to be set. @param {string} name */
    aboutToSet: (name) => {
      editor.beginStep();
      void attempt(() => setReference(name));
    },
    /** Another part of the page is about to change the scene. */
    aboutToChange: () => editor.beginStep(),
    latitudeDeg: () => /** @type {number | null} */ (editor.state.document?.sun?.place_and_time?.latitude_deg ?? null),
  };
}
