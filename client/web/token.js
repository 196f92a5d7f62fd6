// @ts-check
/**
 * The token that a server may demand: kept in `sessionStorage`, so for this tab alone, and sent with every request to this
 * page's own server. Where it is refused, a small dialog asks for it. It never becomes part of an address.
 */

const KEY = "skycell-token";
/** A token that no header could hold is none. */
const TOKEN = /^[!-~]{1,512}$/;

/** @returns {string | null} */
export function storedToken() {
  try {
    return sessionStorage.getItem(KEY);
  } catch {
    return null; // storage is switched off: then it is asked for again
  }
}

/** @param {string | null} token */
function store(token) {
  try {
    if (token === null) sessionStorage.removeItem(KEY);
    else sessionStorage.setItem(KEY, token);
  } catch {
    // As above.
  }
}

/**
 * Whether a request goes to the interface of this page's own server, and nowhere else.
 * @param {string | URL | Request} target
 * @param {string} base
 */
export function isOwnApi(target, base) {
  const url = new URL(target instanceof Request ? target.url : target, base);
  const root = new URL(".", base);
  return url.origin === root.origin && url.pathname.startsWith(`${root.pathname}api/`);
}

/**
 * The same request with the token.
 * @param {RequestInit | undefined} init
 * @param {string} token
 * @returns {RequestInit}
 */
export function withToken(init, token) {
  const headers = new Headers(init?.headers);
  headers.set("Authorization", `Bearer ${token}`);
  return { ...init, headers };
}

/** @type {Promise<string | null> | null} */
let asking = null;

/**
 * Asks for the token; who asks while the dialog is open gets the same answer. Null if it was dismissed.
 * @param {string} why
 */
export function askForToken(why) {
  asking ??= ask(why).finally(() => {
    asking = null;
  });
  return asking;
}

/**
 * @param {string} why
 * @returns {Promise<string | null>}
 */
function ask(why) {
  store(null);
  const dialog = document.createElement("dialog");
  dialog.className = "token-dialog";
  dialog.setAttribute("aria-labelledby", "token-title");
  const form = document.createElement("form");
  form.method = "dialog";
  const title = document.createElement("h2");
  title.id = "token-title";
  title.textContent = "This sky needs a token";
  const told = document.createElement("p");
  told.id = "token-told";
  told.textContent = why;
  const label = document.createElement("label");
  label.htmlFor = "token";
  label.textContent = "Token";
  const field = document.createElement("input");
  Object.assign(field, { id: "token", type: "password", required: true, autocomplete: "off", spellcheck: false });
  field.pattern = "[!-~]{1,512}";
  field.setAttribute("aria-describedby", "token-told");
  const note = document.createElement("p");
  note.className = "token-note";
  note.textContent = "Kept in this tab until it is closed. Whoever runs the server hands tokens out.";
  const buttons = document.createElement("p");
  buttons.className = "token-buttons";
  const enter = Object.assign(document.createElement("button"), { type: "submit", value: "enter", textContent: "Enter" });
  const later = Object.assign(document.createElement("button"), { type: "button", textContent: "Not now" });
  later.addEventListener("click", () => dialog.close(""));
  buttons.append(enter, later);
  form.append(title, told, label, field, note, buttons);
  dialog.append(form);
  document.body.append(dialog);
  dialog.showModal();
  return new Promise((resolve) => {
    dialog.addEventListener("close", () => {
      const token = dialog.returnValue === "enter" && TOKEN.test(field.value.trim()) ? field.value.trim() : null;
      dialog.remove();
      if (token !== null) store(token);
      resolve(token);
    });
  });
}

/**
 * A token other than the one that was refused; asked for only where none is known. A refusal may come late: another
 * request may have been told a token since, and that one must not be thrown away.
 * @param {string | null} refused  what was sent; null if nothing was
 * @returns {Promise<string | null>}
 */
export async function otherToken(refused) {
  const known = storedToken();
  if (known !== null && known !== refused) return known;
  return askForToken(refused === null ? FIRST : AGAIN);
}

/**
 * Lets every request of this page to its own server carry the token, and asks for it where the server refuses.
 * @param {{ fetch: typeof fetch }} [scope]
 */
export function sendTokens(scope = globalThis) {
  const plainFetch = scope.fetch.bind(scope);
  scope.fetch = async (target, init) => {
    if (!isOwnApi(target, location.href)) return plainFetch(target, init);
    let sent = storedToken();
    let answer = await plainFetch(target, sent === null ? init : withToken(init, sent));
    while (answer.status === 401) {
      const token = await otherToken(sent);
      if (token === null) return answer;
      sent = token;
      answer = await plainFetch(target, withToken(init, token));
    }
    return answer;
  };
  // A link cannot send a header: what it leads to is fetched, and then saved.
  document.addEventListener("click", (event) => {
    const link = event.target instanceof Element ? event.target.closest("a[download]") : null;
    if (!(link instanceof HTMLAnchorElement) || storedToken() === null || !isOwnApi(link.href, location.href)) return;
    event.preventDefault();
    void save(link.href, link.download || "map");
  });
}

const FIRST = "The server lets in those who have one.";
const AGAIN = "The server does not know the token that was entered. Try another one.";

/**
 * For a connection: its token, and what to do where it is refused. Resolves to whether there is another one to try.
 */
export const connectionToken = Object.freeze({
  current: storedToken,
  /** @param {string | null} sent */
  refused: async (sent) => (await otherToken(sent)) !== null,
});

/**
 * @param {string} href
 * @param {string} name
 */
async function save(href, name) {
  const answer = await fetch(href);
  if (!answer.ok) return;
  const url = URL.createObjectURL(await answer.blob());
  Object.assign(document.createElement("a"), { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 10_000);
}
