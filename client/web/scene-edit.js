// @ts-check
/**
 * The scene as the page edits it: values that were changed are sent as merge patches, the newest wins, and none overwrites
 * what the page has not seen. Pure parts first.
 */

import { refusal } from "./maps.js";

/** @typedef {import("./scene-schema.js").Path} Path */

/** While a slider is dragged, requests start this far apart at least. */
const SEND_INTERVAL_MS = 120;
/** Changes within this time of one another are one step of undo; so is all that is changed without letting go of a slider. */
const STEP_MS = 1200;
const STEPS_MAX = 50;
/** What servers write themselves, or another part of the page owns: undo and reset leave it. */
const NOT_OURS = ["version", "time", "drift", "transition"];

/**
 * A copy with another value at a path.
 * @param {any} document
 * @param {Path} path
 * @param {unknown} value
 * @returns {any}
 */
export function withValue(document, [key, ...rest], value) {
  if (key === undefined) return value;
  const copy = Array.isArray(document) ? [...document] : { ...document };
  copy[key] = withValue(copy[key], rest, value);
  return copy;
}

/**
 * @param {any} document
 * @param {Path} path
 * @returns {any}
 */
export function valueAt(document, path) {
  return path.reduce((at, key) => at?.[key], document);
}

/**
 * The merge patch (RFC 7396) that makes one document of another; undefined where nothing differs. Lists are replaced as a whole.
 * @param {any} from
 * @param {any} to
 * @returns {any}
 */
export function mergePatch(from, to) {
  const isObject = (/** @type {any} */ value) => value !== null && typeof value === "object" && !Array.isArray(value);
  if (!isObject(to)) return JSON.stringify(from) === JSON.stringify(to) ? undefined : to;
  if (!isObject(from)) return to;
  /** @type {Record<string, any>} */
  const patch = {};
  for (const key of Object.keys(from)) {
    if (!(key in to)) patch[key] = null;
  }
  for (const [key, value] of Object.entries(to)) {
    const change = mergePatch(from[key], value);
    if (change !== undefined) patch[key] = change;
  }
  return Object.keys(patch).length === 0 ? undefined : patch;
}

/** The number of an ETag; NaN where it has none. @param {string} etag */
function revisionOf(etag) {
  return /^"\d+"$/.test(etag) ? Number(etag.slice(1, -1)) : Number.NaN;
}

/**
 * The same, in words that mean it: in a merge patch null removes, which brings the default back.
 * @param {any} from
 * @param {any} to
 */
export function scenePatch(from, to) {
  const patch = mergePatch(from, to);
  if (patch && patch.planet === null) patch.planet = "flat";
  return patch;
}

/** A name for changes that are one to whoever looks back: nobody else's has it. */
export function newGroup() {
  return [...crypto.getRandomValues(new Uint8Array(8))].map((byte) => byte.toString(16).padStart(2, "0")).join("");
}

/**
 * @typedef {object} SceneState
 * @property {any} document  as it stands on the server; null before it was read
 * @property {any} draft  the same with changes that are on their way
 * @property {string} etag
 * @property {boolean} can_undo
 */

/** Sends changes, one request at a time. */
export class SceneEditor {
  #document = /** @type {any} */ (null);
  #etag = "";
  /** What was changed and not yet sent, by path. @type {Map<string, { path: Path, value: unknown }>} */
  #pending = new Map();
  /** What was sent and not yet answered. @type {Map<string, { path: Path, value: unknown }>} */
  #in_flight = new Map();
  /** A revision that was told of while a request was under way. @type {number | null} */
  #told = null;
  #sending = false;
  #loading = false;
  /** Settles when nothing is left to be sent. @type {Promise<void>} */
  #sent = Promise.resolve();
  #sent_ms = -Infinity;
  /**
   * What the scene was before each step; without an ETag where changes before it were on their way still.
   * @type {{ etag: string, document: any }[]}
   */
  #steps = [];
  #edited_ms = -Infinity;
  /** Names the changes of the present step to the server. */
  #group = newGroup();
  /** The drag that made the last change. @type {object | null} */
  #drag = null;
  /** @type {Set<(state: SceneState) => void>} */ #handlers = new Set();
  /** How many requests were sent. */
  requests = 0;

  /** @param {(text: string, bad: boolean) => void} tell */
  constructor(tell) {
    this.tell = tell;
  }

  /** @returns {SceneState} */
  get state() {
    const draft = [...this.#in_flight.values(), ...this.#pending.values()].reduce((at, { path, value }) => withValue(at, path, value), this.#document);
    return { document: this.#document, draft, etag: this.#etag, can_undo: this.#steps.length > 0 };
  }

  /** @param {(state: SceneState) => void} handler */
  onChange(handler) {
    this.#handlers.add(handler);
    if (this.#document) handler(this.state);
  }

  /** Reads the scene anew; of a revision that was told of, unless that one or a later one is known. @param {number} [revision] */
  async load(revision) {
    if (revision !== undefined) {
      if (this.#sending || this.#loading) {
        this.#told = Math.max(this.#told ?? 0, revision);
        return;
      }
      if (revisionOf(this.#etag) >= revision) return;
    }
    this.#loading = true;
    try {
      const response = await fetch("api/v1/scene", { cache: "no-cache" });
      if (!response.ok) throw new Error(await refusal(response));
      await this.#take(response);
    } finally {
      this.#loading = false;
    }
    await this.#readTold();
  }

  /** Reads what was told of meanwhile. */
  async #readTold() {
    const told = this.#told;
    if (told === null || this.#sending) return;
    this.#told = null;
    await this.load(told);
  }

  /**
   * Changes a value: at once in the draft, soon on the server.
   * @param {Path} path
   * @param {unknown} value
   * @param {object | null} [drag]  stands for a slider that is held: the same one until it is let go
   */
  edit(path, value, drag = null) {
    if (!this.#document) return;
    this.#beginStep(false, drag);
    const key = path.join("/");
    // What is set as a whole does away with what was to be set in it.
    for (const other of this.#pending.keys()) if (other.startsWith(`${key}/`)) this.#pending.delete(other);
    this.#pending.delete(key);
    this.#pending.set(key, { path, value });
    this.#announce();
    if (!this.#sending) this.#sent = this.#send();
  }

  /**
   * Makes the scene another one, in one step.
   * @param {any} wanted  a document; what it does not say of the server's own keys stays
   * @param {boolean} [undoing]
   */
  async replace(wanted, undoing = false) {
    if (!this.#document) return;
    if (!undoing) this.#beginStep(true);
    const target = { ...wanted };
    for (const key of NOT_OURS) target[key] = this.#document[key];
    const patch = scenePatch(this.#document, target);
    if (patch) await this.#request(patch);
  }

  /** Every value its default. */
  async reset() {
    if (!this.#document) return;
    this.#beginStep(true);
    const keys = Object.keys(this.#document).filter((key) => !NOT_OURS.includes(key));
    await this.#request(Object.fromEntries(keys.map((key) => [key, null])));
  }

  /** Takes the last step back. */
  async undo() {
    await this.#sent;
    const before = this.#steps.pop();
    this.#edited_ms = -Infinity;
    this.#drag = null;
    if (before) await this.#revert(before);
    this.#announce();
  }

  /** @param {{ etag: string, document: any }} before */
  async #revert({ etag, document }) {
    const revision = revisionOf(etag);
    if (Number.isNaN(revision)) {
      await this.replace(document, true);
      return;
    }
    this.requests += 1;
    const response = await fetch("api/v1/scene/revert", {
      method: "POST",
      headers: { "Content-Type": "application/json", "If-Match": this.#etag },
      body: JSON.stringify({ revision }),
    });
    if (response.ok) {
      await this.#take(response);
      this.tell("", false);
    } else if (response.status === 404 || response.status === 422) {
      await this.replace(document, true); // no longer kept there, but here
    } else {
      await this.#refused(response);
    }
  }

  /** For what somebody else on the page changes: the scene before it is a step, too. */
  beginStep() {
    if (this.#document) this.#beginStep(true);
  }

  /** @param {boolean} always @param {object | null} [drag] */
  #beginStep(always, drag = null) {
    const now_ms = performance.now();
    const goes_on = drag !== null && drag === this.#drag;
    if (always || (!goes_on && now_ms - this.#edited_ms > STEP_MS)) {
      this.#steps.push({ etag: this.#sending ? "" : this.#etag, document: this.state.draft });
      if (this.#steps.length > STEPS_MAX) this.#steps.shift();
      this.#group = newGroup();
    }
    this.#edited_ms = now_ms;
    this.#drag = drag;
  }

  async #send() {
    this.#sending = true;
    while (this.#pending.size > 0) {
      const wait_ms = this.#sent_ms + SEND_INTERVAL_MS - performance.now();
      if (wait_ms > 0) await new Promise((resolve) => setTimeout(resolve, wait_ms));
      const patch = scenePatch(this.#document, this.state.draft);
      this.#in_flight = this.#pending;
      this.#pending = new Map();
      this.#sent_ms = performance.now();
      if (patch) await this.#request(patch, this.#group);
      this.#in_flight = new Map();
    }
    this.#sending = false;
    this.#announce();
    await this.#readTold().catch(() => {});
  }

  /** @param {object} patch @param {string} [group]  of changes that are one step */
  async #request(patch, group) {
    this.requests += 1;
    try {
      const response = await fetch(`api/v1/scene${group ? `?group=${group}` : ""}`, {
        method: "PATCH",
        headers: { "Content-Type": "application/merge-patch+json", "If-Match": this.#etag },
        body: JSON.stringify(patch),
      });
      this.#in_flight = new Map();
      if (response.ok) {
        await this.#take(response);
        this.tell("", false);
        return;
      }
      this.#steps.pop();
      await this.#refused(response);
    } catch (error) {
      this.#pending.clear();
      this.tell(error instanceof Error ? error.message : String(error), true);
    }
    this.#announce();
  }

  /** @param {Response} response */
  async #refused(response) {
    this.#pending.clear();
    if (response.status === 412) {
      await this.load();
      this.tell("Somebody else changed the sky meanwhile: it is shown anew, and your last change was not made.", true);
    } else {
      this.tell(await refusal(response), true);
    }
  }

  /** @param {Response} response */
  async #take(response) {
    this.#document = await response.json();
    this.#etag = response.headers.get("etag") ?? "*";
    this.#announce();
  }

  #announce() {
    for (const handler of this.#handlers) handler(this.state);
  }
}
