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
      // Another request may have been told the token meanwhile.
      const known = storedToken();
      const token = known !== null && known !== sent ? known : await askForToken(sent === null ? FIRST : AGAIN);
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
  /** @returns {Promise<boolean>} */
  refused: async () => (await askForToken(storedToken() === null ? FIRST : AGAIN)) !== null,
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

const EVENTS_RETRY_MS = 3_000;
/** An event of this server has some hundred bytes. */
const EVENT_MAX_CHARS = 1 << 20;

/**
 * Server-sent events over fetch, because an EventSource sends no token. Comes back by itself when the line breaks.
 *
 * @param {string | URL} url
 * @param {(name: string, data: string) => void} onEvent
 * @returns {() => void}  ends it
 */
export function watchEvents(url, onEvent) {
  const ended = new AbortController();
  void (async () => {
    while (!ended.signal.aborted) {
      try {
        const answer = await fetch(url, { signal: ended.signal, headers: { Accept: "text/event-stream" } });
        if (answer.ok && answer.body) await readEvents(answer.body, onEvent);
        // Who may not watch will not be let in by asking again.
        else if (answer.status === 401 || answer.status === 403) return;
      } catch {
        // The line broke, or it was ended.
      }
      if (!ended.signal.aborted) await new Promise((resolve) => setTimeout(resolve, EVENTS_RETRY_MS));
    }
  })();
  return () => ended.abort();
}

/**
 * @param {ReadableStream<Uint8Array>} body
 * @param {(name: string, data: string) => void} onEvent
 */
async function readEvents(body, onEvent) {
  const reader = body.getReader();
  const decoder = new TextDecoder();
  let text = "";
  for (;;) {
    const { done, value } = await reader.read();
    if (done) return;
    text += decoder.decode(value, { stream: true });
    if (text.length > EVENT_MAX_CHARS) throw new Error("an event has no end");
    const blocks = text.split(/\r?\n\r?\n/);
    text = blocks.pop() ?? "";
    for (const block of blocks) {
      const event = parseEvent(block);
      if (event.data !== "") onEvent(event.name, event.data);
    }
  }
}

/**
 * One event of a stream, without the empty line at its end.
 * @param {string} block
 */
export function parseEvent(block) {
  const event = { name: "message", data: "" };
  const data = [];
  for (const line of block.split(/\r?\n/)) {
    const at = line.indexOf(":");
    const field = at < 0 ? line : line.slice(0, at);
    const value = at < 0 ? "" : line.slice(at + 1).replace(/^ /, "");
    if (field === "event") event.name = value;
    else if (field === "data") data.push(value);
  }
  event.data = data.join("\n");
  return event;
}
