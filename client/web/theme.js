// @ts-check
/** Dark or light: what the system says, or what was chosen here. */

const KEY = "skycell.theme";
const CHOICES = /** @type {const} */ (["system", "light", "dark"]);
/** @typedef {typeof CHOICES[number]} Theme */

/** @returns {Theme} */
function stored() {
  try {
    const text = localStorage.getItem(KEY);
    return CHOICES.find((choice) => choice === text) ?? "system";
  } catch {
    return "system"; // a browser that keeps nothing
  }
}

/** @param {HTMLButtonElement} button */
export function attachTheme(button) {
  let theme = stored();
  const show = () => {
    if (theme === "system") delete document.documentElement.dataset.theme;
    else document.documentElement.dataset.theme = theme;
    const words = { system: "as the system", light: "light", dark: "dark" };
    button.setAttribute("aria-label", `Colours: ${words[theme]}`);
    button.title = `Colours: ${words[theme]} (T)`;
  };
  const next = () => {
    theme = CHOICES[(CHOICES.indexOf(theme) + 1) % CHOICES.length];
    try {
      localStorage.setItem(KEY, theme);
    } catch {
      // It lasts as long as the page.
    }
    show();
  };
  button.addEventListener("click", next);
  show();
  return { next };
}
