// @ts-check
/** What every part of the page needs of its document. */

/**
 * @template {HTMLElement} T
 * @param {string} id
 * @param {new () => T} type
 * @returns {T}
 */
export function element(id, type) {
  const found = document.getElementById(id);
  if (!(found instanceof type)) throw new Error(`the page has no #${id}`);
  return found;
}

/**
 * Writes only what changed, so that nothing is laid out or read aloud again for nothing.
 * @param {string} id
 * @param {string} text
 */
export function write(id, text) {
  const target = element(id, HTMLElement);
  if (target.textContent !== text) target.textContent = text;
}
