// @ts-check
/**
 * Maps of the sky by drag and drop: three zones for each layer that has maps, shown while a file is dragged over the page
 * or when the button asks for them. Needs the markup of index.html (#maps and what is in it).
 */

const KINDS = /** @type {const} */ ({
  coverage: "where clouds are",
  type: "how tall they are",
  profile: "type across, height up",
});
const ACCEPTED = ".png,.exr,image/png,image/x-exr";

/** @typedef {keyof typeof KINDS} MapKind */

/**
 * Names of the scene's layers that have maps.
 * @param {any} scene
 * @returns {string[]}
 */
export function weatherLayers(scene) {
  const layers = Array.isArray(scene?.layers) ? scene.layers : [];
  return layers.filter((/** @type {any} */ layer) => layer?.density?.model === "weather").map((/** @type {any} */ layer) => String(layer.name));
}

/**
 * Where a map is.
 * @param {MapKind} kind
 * @param {string} layer
 * @param {Record<string, string>} [more]
 */
export function mapPath(kind, layer, more = {}) {
  return `api/v1/scene/maps/${kind}?${new URLSearchParams({ layer, ...more })}`;
}

/**
 * What a refused request says.
 * @param {Response} response
 */
export async function refusal(response) {
  try {
    const problem = await response.json();
    if (typeof problem.detail === "string" && problem.detail !== "") return problem.detail;
  } catch {
    // No problem document: a proxy answered. The status says it all.
  }
  return `the server answers ${response.status}`;
}

/**
 * @param {{ panel: HTMLElement, zones: HTMLElement, told: HTMLElement, seconds: HTMLInputElement, opener: HTMLButtonElement }} parts
 */
export function attachMaps({ panel, zones, told, seconds, opener }) {
  let dragging = 0;
  let pinned = false;

  /** @param {string} text @param {boolean} [bad] */
  function tell(text, bad = false) {
    told.textContent = text;
    told.classList.toggle("problem", bad);
  }

  async function scene() {
    const response = await fetch("api/v1/scene", { cache: "no-cache" });
    if (!response.ok) throw new Error(await refusal(response));
    return { etag: response.headers.get("etag") ?? "*", document: await response.json() };
  }

  /**
   * Replaces a map, or brings the generated one back.
   * @param {MapKind} kind
   * @param {string} layer
   * @param {File | null} file
   */
  async function change(kind, layer, file) {
    tell(file ? `Sending ${file.name}…` : "Resetting…");
    try {
      const { etag } = await scene();
      const response = await fetch(mapPath(kind, layer, { transition_s: String(seconds.valueAsNumber || 0) }), {
        method: file ? "PUT" : "DELETE",
        headers: { "If-Match": etag },
        body: file,
      });
      if (!response.ok) throw new Error(await refusal(response));
      tell(file ? `${file.name} is the ${kind} map of layer ${layer}.` : `Layer ${layer} has its generated ${kind} map again.`);
    } catch (error) {
      tell(`The ${kind} map stays as it is: ${error instanceof Error ? error.message : error}`, true);
    }
  }

  /** @param {MapKind} kind @param {string} layer */
  function zone(kind, layer) {
    const box = document.createElement("section");
    box.className = "zone";
    box.dataset.map = kind;
    box.dataset.layer = layer;
    const title = document.createElement("h3");
    title.textContent = kind;
    const meaning = document.createElement("p");
    meaning.textContent = KINDS[kind];
    const picker = document.createElement("input");
    picker.type = "file";
    picker.accept = ACCEPTED;
    picker.setAttribute("aria-label", `${kind} map of layer ${layer}`);
    picker.addEventListener("change", () => {
      const [file] = picker.files ?? [];
      if (file) void change(kind, layer, file);
    });
    const download = document.createElement("a");
    download.href = mapPath(kind, layer);
    download.download = "";
    download.textContent = "download";
    const reset = document.createElement("button");
    reset.type = "button";
    reset.textContent = "back to generated";
    reset.addEventListener("click", () => void change(kind, layer, null));
    const foot = document.createElement("p");
    foot.append(download, reset);
    box.append(title, meaning, picker, foot);
    box.addEventListener("dragover", (event) => {
      event.preventDefault();
      box.classList.add("over");
    });
    box.addEventListener("dragleave", () => box.classList.remove("over"));
    box.addEventListener("drop", (event) => {
      event.preventDefault();
      event.stopPropagation();
      box.classList.remove("over");
      dragging = 0;
      pinned = true; // so that the answer can be read
      const [file] = event.dataTransfer?.files ?? [];
      if (file) void change(kind, layer, file);
      else tell("That was no file.", true);
    });
    return box;
  }

  async function fill() {
    try {
      const layers = weatherLayers((await scene()).document);
      zones.replaceChildren(
        ...layers.map((layer) => {
          const row = document.createElement("div");
          row.className = "zones";
          const name = document.createElement("h2");
          name.textContent = `Layer ${layer}`;
          row.append(name, ...Object.keys(KINDS).map((kind) => zone(/** @type {MapKind} */ (kind), layer)));
          return row;
        }),
      );
      if (layers.length === 0) tell("No layer of this scene has maps.", true);
    } catch (error) {
      tell(error instanceof Error ? error.message : String(error), true);
    }
  }

  function show() {
    if (!panel.hidden) return;
    tell("");
    panel.hidden = false;
    void fill();
  }

  function hide() {
    dragging = 0;
    pinned = false;
    panel.hidden = true;
  }

  /** @param {DragEvent} event */
  const hasFile = (event) => event.dataTransfer?.types.includes("Files") ?? false;
  window.addEventListener("dragenter", (event) => {
    if (!hasFile(event)) return;
    event.preventDefault();
    dragging += 1;
    show();
  });
  window.addEventListener("dragover", (event) => {
    // Without this the browser would leave the page for the file.
    if (hasFile(event)) event.preventDefault();
  });
  window.addEventListener("dragleave", (event) => {
    if (!hasFile(event)) return;
    dragging = Math.max(dragging - 1, 0);
    if (dragging === 0 && !pinned) hide();
  });
  window.addEventListener("drop", (event) => {
    if (!hasFile(event)) return;
    event.preventDefault();
    dragging = 0;
    pinned = true;
    tell("Drop the file on the map that it is to replace.", true);
  });
  opener.addEventListener("click", () => {
    if (panel.hidden) {
      pinned = true;
      show();
    } else {
      hide();
    }
  });
  window.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && !panel.hidden) hide();
  });
}
