// @ts-check
/** Skies by name, with a small picture of each. */

/**
 * @param {HTMLElement} gallery
 * @param {import("./sky.js").Preset[]} presets
 * @param {(preset: import("./sky.js").Preset) => void} onChoose
 * @returns {{ mark: (name: string | null) => void }}
 */
export function showPresets(gallery, presets, onChoose) {
  const cards = presets.map((preset) => {
    const card = document.createElement("button");
    card.type = "button";
    card.className = "card";
    card.dataset.preset = preset.name;
    card.title = preset.about;
    card.setAttribute("aria-pressed", "false");
    const picture = document.createElement("img");
    picture.src = `presets/${preset.name}.jpg`;
    picture.alt = "";
    picture.width = 192;
    picture.height = 108;
    picture.loading = "lazy";
    // A preset of the operator's may have none.
    picture.addEventListener("error", () => card.classList.add("plain"));
    const title = document.createElement("span");
    title.textContent = preset.title;
    card.append(picture, title);
    card.addEventListener("click", () => onChoose(preset));
    return card;
  });
  gallery.replaceChildren(...cards);
  return {
    mark(name) {
      for (const card of cards) card.setAttribute("aria-pressed", String(card.dataset.preset === name));
    },
  };
}
