// @ts-check
/** The panel of the scene: rows of lil-gui for the fields that the server's schema tells of. */

import { panelOf, rounded, shapeOf, sliderScale } from "./scene-schema.js";
import { valueAt } from "./scene-edit.js";
import { GUI } from "./vendor/lil-gui/lil-gui.esm.js";

/** @typedef {import("./scene-schema.js").Field} Field */
/** @typedef {import("./scene-schema.js").Path} Path */
/** @typedef {import("./scene-edit.js").SceneEditor} SceneEditor */
/** @typedef {import("./vendor/lil-gui/lil-gui.esm.js").Controller} Controller */
/** @typedef {{ update: (field: any) => void }} Row */

/** Groups that stand open at first. */
const OPEN = new Set(["Clouds", "Clouds/0", "Clouds/0/density", "Sun"]);
const SLIDER_STEPS = 1000;

/**
 * @param {object} options
 * @param {HTMLElement} options.container
 * @param {SceneEditor} options.editor
 * @param {() => any} options.reference  the scene that single values are reset to; null: the defaults
 * @param {() => void} options.onShown  after rows came or went
 */
export function createScenePanel({ container, editor, reference, onShown }) {
  /** @type {any} */
  let openapi = null;
  let shape = "";
  /** @type {GUI | null} */
  let gui = null;
  /** @type {Map<string, Row>} */
  const rows = new Map();
  /** Families that a new layer may have. @type {string[]} */
  let families = ["cumulus"];
  /** Which groups were opened or closed by hand. @type {Map<string, boolean>} */
  const open = new Map();

  /** @param {string} path */
  const idOf = (path) => `field-${path.replaceAll("/", "-")}`;

  /**
   * What a value is reset to: that of the reference, or the default; undefined where neither is known.
   * @param {Path} path
   * @param {any} fallback
   */
  const resetValue = (path, fallback) => {
    const scene = reference();
    return scene === null ? (fallback ?? undefined) : valueAt(scene, path);
  };

  /**
   * The row's explanation, and its button back.
   * @param {Controller} controller
   * @param {Field & { fallback?: any }} field
   * @param {any} value
   * @returns {(value: any) => void}  tells the row what its value is
   */
  function dress(controller, field, value) {
    const row = controller.domElement;
    row.dataset.path = field.path.join("/");
    if (field.about) row.title = field.about;
    const back = document.createElement("button");
    back.type = "button";
    back.className = "back";
    back.textContent = "↺";
    row.append(back);
    const show = (/** @type {any} */ now) => {
      const target = resetValue(field.path, field.fallback);
      const differs = target !== undefined && target !== null && typeof target !== "object" && target !== now;
      back.hidden = !differs;
      row.classList.toggle("changed", differs);
      if (!differs) return;
      back.title = `Back to ${typeof target === "number" ? Number(target.toPrecision(6)) : target}`;
      back.setAttribute("aria-label", `${field.label}: back to ${target}`);
    };
    back.addEventListener("click", () => {
      const target = resetValue(field.path, field.fallback);
      if (target !== undefined) editor.edit(field.path, target);
    });
    show(value);
    return show;
  }

  /**
   * @param {GUI} folder
   * @param {import("./scene-schema.js").NumberField} field
   */
  function addNumber(folder, field) {
    const bound = { value: field.value };
    const clamped = (/** @type {number} */ value) => Math.min(field.max, Math.max(field.min, field.whole ? Math.round(value) : value));
    const controller = folder.add(bound, "value").name(field.label);
    const span = field.max - field.min;
    controller.step(field.whole ? 1 : Number.isFinite(span) ? Math.min(1, 10 ** Math.floor(Math.log10(Math.max(span, 1e-6) / 200))) : 0.1);
    controller.onChange((/** @type {number} */ value) => editor.edit(field.path, clamped(value)));
    controller.onFinishChange(() => {
      bound.value = clamped(bound.value);
      controller.updateDisplay();
    });
    const input = controller.domElement.querySelector("input");
    if (input) input.id = idOf(field.path.join("/"));
    const unit = document.createElement("span");
    unit.className = "unit";
    unit.textContent = field.unit;
    controller.domElement.querySelector(".lil-widget")?.append(unit);
    /** Stands for the slider's movement from when it is taken until it is let go. @type {object | null} */
    let drag = null;
    /** @type {HTMLInputElement | null} */
    let slider = null;
    if (Number.isFinite(span) && span > 0) {
      const scale = sliderScale(field);
      slider = document.createElement("input");
      slider.type = "range";
      slider.className = "slide";
      slider.min = "0";
      slider.max = String(SLIDER_STEPS);
      slider.step = field.whole && span <= SLIDER_STEPS ? String(SLIDER_STEPS / span) : "1";
      slider.setAttribute("aria-label", field.unit ? `${field.label}, ${field.unit}` : field.label);
      slider.addEventListener("input", () => {
        drag ??= {};
        const value = clamped(rounded(scale.valueAt(Number(slider?.value) / SLIDER_STEPS), field.whole));
        bound.value = value;
        controller.updateDisplay();
        slider?.setAttribute("aria-valuetext", `${value} ${field.unit}`);
        editor.edit(field.path, value, drag);
      });
      slider.addEventListener("change", () => {
        drag = null;
      });
      controller.domElement.classList.add("slid");
      controller.domElement.querySelector(".lil-widget")?.prepend(slider);
    }
    const showBack = dress(controller, field, field.value);
    const update = (/** @type {import("./scene-schema.js").NumberField} */ now) => {
      bound.value = now.value;
      controller.updateDisplay();
      if (slider && drag === null) {
        slider.value = String(sliderScale(now).placeOf(now.value) * SLIDER_STEPS);
        slider.setAttribute("aria-valuetext", `${now.value} ${now.unit}`);
      }
      showBack(now.value);
    };
    update(field);
    rows.set(field.path.join("/"), { update });
  }

  /**
   * @param {GUI} folder
   * @param {Exclude<Field, { kind: "group" | "list" | "number" }>} field
   */
  function addPlain(folder, field) {
    const bound = { value: field.value };
    const controller =
      field.kind === "choice" || field.kind === "model"
        ? folder.add(/** @type {{ value: string }} */ (bound), "value", Object.fromEntries(field.names.map((name) => [name || "none", name])))
        : folder.add(bound, "value");
    controller.name(field.label);
    controller.onChange((/** @type {any} */ value) => {
      // Another form of an object has other keys: it begins with its defaults.
      if (field.kind === "model") editor.edit(field.path.slice(0, -1), { [String(field.path.at(-1))]: value });
      else if (field.kind !== "text") editor.edit(field.path, value === "" ? null : value);
    });
    controller.onFinishChange((/** @type {any} */ value) => {
      if (field.kind === "text" && value !== "") editor.edit(field.path, String(value).slice(0, field.max_length));
    });
    const input = controller.domElement.querySelector("input, select");
    if (input) input.id = idOf(field.path.join("/"));
    const showBack = field.kind === "model" ? () => {} : dress(controller, field, field.value);
    if (field.kind === "model") controller.domElement.dataset.path = field.path.join("/");
    rows.set(field.path.join("/"), {
      update(now) {
        bound.value = now.value;
        controller.updateDisplay();
        showBack(now.value);
      },
    });
  }

  /**
   * @param {GUI} parent
   * @param {string} title
   * @param {string} about
   * @param {string} id
   */
  function addFolder(parent, title, about, id) {
    const folder = parent.addFolder(title);
    const heading = folder.domElement.querySelector("button");
    if (heading && about) heading.title = about;
    folder.domElement.dataset.group = id;
    if (!(open.get(id) ?? OPEN.has(id))) folder.close();
    folder.onOpenClose((/** @type {GUI} */ changed) => {
      if (changed === folder) open.set(id, !folder._closed);
    });
    return folder;
  }

  /**
   * @param {GUI} folder
   * @param {Field} field
   * @param {string} group
   * @param {boolean} [flat]  its rows stand in the folder itself
   */
  function addField(folder, field, group, flat = false) {
    if (field.kind === "number") return addNumber(folder, field);
    if (field.kind === "list") return addList(folder, field, group);
    if (field.kind !== "group") return addPlain(folder, field);
    const id = flat ? group : `${group}/${field.path.at(-1)}`;
    const inner = flat ? folder : addFolder(folder, field.label, field.about, id);
    if (field.optional) {
      const bound = { present: field.present };
      const word = flat ? field.label : "On";
      const controller = inner.add(bound, "present").name(word);
      controller.domElement.dataset.path = field.path.join("/");
      controller.onChange((/** @type {boolean} */ on) => editor.edit(field.path, on ? {} : null));
    }
    for (const child of field.children) addField(inner, child, id);
    return undefined;
  }

  /**
   * @param {GUI} folder
   * @param {import("./scene-schema.js").ListField} list
   * @param {string} group
   */
  function addList(folder, list, group) {
    const items = () => /** @type {any[]} */ (valueAt(editor.state.draft, list.path));
    for (const [index, item] of list.children.entries()) {
      const id = `${group}/${index}`;
      const inner = addFolder(folder, `Layer ${item.label}`, item.about, id);
      for (const child of item.children) addField(inner, child, id);
      const actions = { remove: () => editor.edit(list.path, items().toSpliced(index, 1)) };
      inner.add(actions, "remove").name(`Remove layer ${item.label}`);
    }
    const first = list.children[0];
    const family = first?.children.find((child) => child.path.at(-1) === "family");
    // Without a layer there is none to ask.
    if (family?.kind === "choice") families = family.names.filter((name) => name !== "");
    if (list.children.length < list.max) {
      const bound = { family: "" };
      const adding = folder.add(bound, "family", { "choose a family": "", ...Object.fromEntries(families.map((name) => [name, name])) });
      adding.name("Add a layer");
      adding.domElement.dataset.path = "add-layer";
      adding.onChange((/** @type {string} */ name) => {
        if (name === "") return;
        const taken = new Set(items().map((item) => item.name));
        const free = [name, ...[2, 3, 4, 5].map((n) => `${name}-${n}`)].find((one) => !taken.has(one));
        editor.edit(list.path, [...items(), { family: name, name: free }]);
      });
    }
  }

  /** @param {any} scene */
  function build(scene) {
    const panel = panelOf(openapi, scene);
    const next = shapeOf(panel);
    if (next !== shape || !gui) {
      shape = next;
      const focused = document.activeElement?.id;
      const scrolled = container.scrollTop;
      gui?.destroy();
      rows.clear();
      gui = new GUI({ container, title: "Scene", injectStyles: false });
      for (const { title, about, fields } of panel) {
        const folder = addFolder(gui, title, about, title);
        for (const field of fields) addField(folder, field, title, fields.length === 1 || field.kind === "group");
      }
      container.scrollTop = scrolled;
      if (focused?.startsWith("field-")) document.getElementById(focused)?.focus();
      onShown();
      return;
    }
    const update = (/** @type {Field} */ field) => {
      if (field.kind === "group" || field.kind === "list") for (const child of field.children) update(child);
      else rows.get(field.path.join("/"))?.update(field);
    };
    for (const { fields } of panel) for (const field of fields) update(field);
  }

  editor.onChange(({ draft }) => {
    if (openapi && draft) build(draft);
  });

  return {
    /** @param {any} document  the API's own description */
    describe(document) {
      openapi = document;
      if (editor.state.draft) build(editor.state.draft);
    },
    isDescribed: () => openapi !== null,
    /** After the reference changed. */
    refresh() {
      if (openapi && editor.state.draft) build(editor.state.draft);
    },
  };
}
