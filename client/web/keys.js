// @ts-check
/** Keys of the whole page; those of the picture are in look.js. */

/**
 * The list that the page shows, too.
 * @type {[keys: string, what: string][]}
 */
export const KEYS = [
  ["← → ↑ ↓", "look around (on the picture)"],
  ["+ −", "zoom (on the picture)"],
  ["Home", "look where the page began (on the picture)"],
  ["P", "panel"],
  ["M", "maps"],
  ["C", "cells and viewers"],
  ["L", "latency and rate"],
  ["Space", "pause the sky, or resume it"],
  ["Ctrl Z", "take the last change of the scene back"],
  ["S", "save the picture"],
  ["F", "full screen"],
  ["H", "hide everything but the picture, and show it again"],
  ["T", "dark or light"],
  ["?", "this list"],
  ["Esc", "close what is open"],
];

/**
 * Whether a key is for what has the focus, and not for the page.
 * @param {EventTarget | null} target
 * @param {string} key
 */
export function isTyping(target, key) {
  if (!(target instanceof HTMLElement)) return false;
  if (target.closest("dialog[open]")) return true;
  if (target.matches("input:not([type=range]):not([type=checkbox]), textarea, select")) return true;
  return key === " " && target.matches("button, input, summary, a, [role=tab]");
}

/**
 * @param {Record<string, () => void>} actions  by KeyboardEvent.key in lower case; "ctrl+z" for that
 */
export function attachKeys(actions) {
  window.addEventListener("keydown", (event) => {
    if (event.defaultPrevented || event.altKey || isTyping(event.target, event.key)) return;
    const with_control = event.ctrlKey || event.metaKey;
    const action = actions[with_control ? `ctrl+${event.key.toLowerCase()}` : event.key.toLowerCase()];
    if (!action) return;
    event.preventDefault();
    action();
  });
}

/**
 * @param {HTMLDialogElement} dialog
 * @param {HTMLElement} list
 * @param {HTMLButtonElement} opener
 * @param {HTMLButtonElement} closer
 */
export function attachHelp(dialog, list, opener, closer) {
  for (const [keys, what] of KEYS) {
    const term = document.createElement("dt");
    for (const key of keys.split(" ")) {
      const cap = document.createElement("kbd");
      cap.textContent = key;
      term.append(cap);
    }
    const meaning = document.createElement("dd");
    meaning.textContent = what;
    list.append(term, meaning);
  }
  const open = () => dialog.showModal();
  opener.addEventListener("click", open);
  closer.addEventListener("click", () => dialog.close());
  dialog.addEventListener("click", (event) => {
    if (event.target === dialog) dialog.close(); // beside it
  });
  return { open };
}
