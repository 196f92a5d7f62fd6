// @ts-check
/** The panel at the side: tabs, one of which is shown, or none. */

const KEY = "skycell.side";
/** From this width on it stands open at first. */
const WIDE_PX = 1180;

/**
 * @param {object} parts
 * @param {HTMLElement} parts.panel
 * @param {HTMLButtonElement} parts.opener
 * @param {HTMLButtonElement} parts.closer
 * @param {HTMLElement[]} parts.tabs  role tab, with aria-controls
 * @param {(tab: string) => void} parts.onShown  the id of a tab whenever its page comes to be seen
 */
export function attachSide({ panel, opener, closer, tabs, onShown }) {
  const pages = tabs.map((tab) => document.getElementById(tab.getAttribute("aria-controls") ?? ""));
  let chosen = 0;

  /** @param {number} index */
  const choose = (index) => {
    chosen = (index + tabs.length) % tabs.length;
    for (const [i, tab] of tabs.entries()) {
      tab.setAttribute("aria-selected", String(i === chosen));
      tab.tabIndex = i === chosen ? 0 : -1;
      const page = pages[i];
      if (page) page.hidden = i !== chosen;
    }
    if (panel.hidden === false) onShown(tabs[chosen].id);
  };

  /** @param {boolean} open @param {boolean} [byHand] */
  const show = (open, byHand = true) => {
    panel.hidden = !open;
    opener.setAttribute("aria-expanded", String(open));
    document.documentElement.dataset.side = open ? "open" : "closed";
    if (byHand) {
      try {
        localStorage.setItem(KEY, open ? "open" : "closed");
      } catch {
        // It lasts as long as the page.
      }
      if (open) tabs[chosen].focus();
      else opener.focus();
    }
    if (open) onShown(tabs[chosen].id);
  };

  for (const [i, tab] of tabs.entries()) {
    tab.addEventListener("click", () => choose(i));
    tab.addEventListener("keydown", (event) => {
      const to = { ArrowRight: chosen + 1, ArrowLeft: chosen - 1, Home: 0, End: tabs.length - 1 }[event.key];
      if (to === undefined) return;
      event.preventDefault();
      choose(to);
      tabs[chosen].focus();
    });
  }
  opener.addEventListener("click", () => show(panel.hidden === true));
  closer.addEventListener("click", () => show(false));
  panel.addEventListener("keydown", (event) => {
    if (event.key === "Escape") show(false);
  });

  let stored = null;
  try {
    stored = localStorage.getItem(KEY);
  } catch {
    // Nothing is kept.
  }
  choose(0);
  show(innerWidth >= WIDE_PX && stored !== "closed", false);
  return { toggle: () => show(panel.hidden === true), choose, isOpen: () => panel.hidden === false };
}
