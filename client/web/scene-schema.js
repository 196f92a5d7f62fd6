// @ts-check
/**
 * What a panel shows of a scene: a tree of fields, made from the schema that the server tells (`/api/v1/openapi.json`,
 * `#/components/schemas/Scene`) and the values that are there. Pure.
 *
 * @typedef {(string | number)[]} Path
 * @typedef {Record<string, any>} Schema
 *
 * @typedef {object} Head  what every field has
 * @property {Path} path
 * @property {string} label  for people, without its unit
 * @property {string} about  what it means; "" where the schema does not say
 *
 * @typedef {Head & { kind: "number", value: number, min: number, max: number, whole: boolean, unit: string, fallback: number | null }} NumberField
 * @typedef {Head & { kind: "boolean", value: boolean, fallback: boolean | null }} BooleanField
 * @typedef {Head & { kind: "choice", value: string, names: string[], fallback: string | null }} ChoiceField  "" stands for null
 * @typedef {Head & { kind: "text", value: string, max_length: number, fallback: string | null }} TextField
 * @typedef {Head & { kind: "model", value: string, names: string[], others: Record<string, string[]> }} ModelField
 *   which of several forms an object has; others: keys of each form
 * @typedef {Head & { kind: "group", children: Field[], optional: boolean, present: boolean }} GroupField
 * @typedef {Head & { kind: "list", children: GroupField[], max: number }} ListField
 * @typedef {NumberField | BooleanField | ChoiceField | TextField | ModelField | GroupField | ListField} Field
 */

/** Written by servers, or shown elsewhere on the page. */
const HIDDEN = new Set(["version", "time", "animation", "transition", "drift", "maps", "place_and_time"]);

/** How units are written, by the schema's names. */
const UNITS = /** @type {Record<string, string>} */ ({
  m: "m",
  km: "km",
  s: "s",
  deg: "°",
  rad: "rad",
  um: "µm",
  ev: "EV",
  per_m: "1/m",
  m_per_s: "m/s",
  w_per_m2_nm: "W/m²nm",
  w_per_m2_nm_sr: "W/m²nm sr",
  dobson: "DU",
  ms: "ms",
  mib: "MiB",
});
const SUFFIXES = Object.keys(UNITS).sort((a, b) => b.length - a.length);
const CHANNELS = ["red", "green", "blue"];

/**
 * @param {string} key
 * @returns {string}
 */
function unitOfKey(key) {
  return SUFFIXES.find((suffix) => key.endsWith(`_${suffix}`)) ?? "";
}

/**
 * `base_altitude_m` as "Base altitude".
 * @param {string} key
 */
export function labelOf(key) {
  const unit = unitOfKey(key);
  const words = (unit === "" ? key : key.slice(0, -unit.length - 1)).replaceAll("_", " ");
  return words.charAt(0).toUpperCase() + words.slice(1);
}

/**
 * Both at once; where they differ the second has it.
 * @param {Schema} a
 * @param {Schema} b
 * @returns {Schema}
 */
function together(a, b) {
  const properties = a.properties || b.properties ? { properties: { ...a.properties, ...b.properties } } : {};
  return { ...a, ...b, ...properties };
}

/**
 * @param {Schema} root  the whole OpenAPI document
 * @param {Schema} schema
 * @returns {Schema}
 */
function resolve(root, schema) {
  let found = schema;
  for (let steps = 0; typeof found.$ref === "string" && steps < 8; steps += 1) {
    const { $ref, ...beside } = found;
    const target = $ref.split("/").slice(1).reduce((at, key) => at?.[key], /** @type {any} */ (root)) ?? {};
    found = together(target, beside);
  }
  if (Array.isArray(found.allOf)) {
    const { allOf, ...beside } = found;
    const parts = allOf.map((/** @type {Schema} */ part) => resolve(root, part));
    found = together(parts.reduce(together, {}), beside);
  }
  return found;
}

/**
 * The forms that a value may have, null apart.
 * @param {Schema} root
 * @param {Schema} schema
 * @returns {{ forms: Schema[], nullable: boolean }}
 */
function formsOf(root, schema) {
  const types = Array.isArray(schema.type) ? schema.type : [schema.type];
  const listed = schema.oneOf ?? schema.anyOf;
  if (!Array.isArray(listed)) {
    const others = types.filter((type) => type !== "null");
    return { forms: [{ ...schema, type: others.length === 1 ? others[0] : schema.type }], nullable: types.includes("null") };
  }
  const forms = listed.map((form) => resolve(root, form)).flatMap((form) => {
    const inner = formsOf(root, form);
    return form.oneOf || form.anyOf ? inner.forms : [form];
  });
  const isNull = (/** @type {Schema} */ form) => form.type === "null" || form.const === null;
  const objects = forms.filter((form) => form.type === "object" || form.properties);
  const plain = forms.filter((form) => !isNull(form));
  // A word that stands beside an object ("flat" beside a planet) is another way to say that there is none.
  return { forms: objects.length > 0 ? objects : plain, nullable: plain.length < forms.length };
}

/**
 * Keys of an object in the order in which documents have them.
 * @param {Schema} form
 * @returns {string[]}
 */
function keysOf(form) {
  const keys = Object.keys(form.properties ?? {});
  const order = Array.isArray(form["x-order"]) ? form["x-order"] : [];
  const place = (/** @type {string} */ key) => (order.includes(key) ? order.indexOf(key) : order.length);
  return keys.toSorted((a, b) => place(a) - place(b));
}

/**
 * The one word that a property of a form may have.
 * @param {Schema} root
 * @param {Schema} form
 * @param {string} key
 * @returns {string | null}
 */
function onlyWord(root, form, key) {
  const property = form.properties?.[key];
  if (!property) return null;
  const { const: constant, enum: words } = resolve(root, property);
  const word = constant ?? (Array.isArray(words) && words.length === 1 ? words[0] : null);
  return typeof word === "string" ? word : null;
}

/**
 * Fields of a value.
 * @param {Schema} root
 * @param {Schema} schema
 * @param {any} value
 * @param {Path} path
 * @param {string} [label]
 * @returns {Field | null}  null for what a panel does not show
 */
function fieldOf(root, schema, value, path, label) {
  const key = String(path.at(-1) ?? "");
  const found = resolve(root, schema);
  const head = { path, label: label ?? labelOf(key), about: typeof found.description === "string" ? found.description : "" };
  const { forms, nullable } = formsOf(root, found);
  const form = forms[0];
  if (!form) return null;
  const kind = form.properties ? "object" : form.type;
  if (kind === "object") {
    const tag = ["model", "form", "kind"].find((name) => forms.every((one) => onlyWord(root, one, name) !== null));
    if (forms.length > 1 && tag === undefined) return null;
    const present = value !== null && typeof value === "object";
    const shown = tag === undefined ? form : (forms.find((one) => onlyWord(root, one, tag) === value?.[tag]) ?? form);
    /** @type {Field[]} */
    const children = [];
    if (present && tag !== undefined && forms.length > 1) {
      const entries = forms.map((one) => /** @type {[string, string[]]} */ ([onlyWord(root, one, tag) ?? "", Object.keys(one.properties)]));
      const names = entries.map(([name]) => name);
      children.push({
        kind: "model",
        path: [...path, tag],
        label: labelOf(tag),
        about: String(shown.description ?? ""),
        value: String(value[tag]),
        names,
        others: Object.fromEntries(entries),
      });
    }
    for (const name of present ? keysOf(shown) : []) {
      if (HIDDEN.has(name) || name === tag) continue;
      const child = fieldOf(root, shown.properties[name], value[name], [...path, name]);
      if (child) children.push(child);
    }
    return { ...head, kind: "group", children, optional: nullable, present };
  }
  if (kind === "array") {
    const eachAt = (/** @type {number} */ index) => resolve(root, form.prefixItems?.[index] ?? form.items ?? {});
    const each = eachAt(0);
    if (!Array.isArray(value)) return null;
    if (each.type === "number" && value.length <= 4) {
      const names = value.length === 3 ? CHANNELS : value.map((_, index) => String(index + 1));
      const unit = form["x-unit"] ?? found["x-unit"] ?? unitOfKey(key);
      const fallbacks = found.default;
      const children = value.flatMap((_, index) => {
        const one = { "x-unit": unit, ...eachAt(index), ...(Array.isArray(fallbacks) && { default: fallbacks[index] }) };
        const field = fieldOf(root, one, value[index], [...path, index], labelOf(names[index]));
        return field ? [field] : [];
      });
      return { ...head, kind: "group", children, optional: false, present: true };
    }
    if (!each.properties) return null;
    const children = value.flatMap((item, index) => {
      const field = fieldOf(root, each, item, [...path, index], String(item?.name ?? index + 1));
      return field?.kind === "group" ? [field] : [];
    });
    return { ...head, kind: "list", children, max: Number(form.maxItems ?? 16) };
  }
  const fallback = found.default ?? form.default ?? null;
  if ((kind === "number" || kind === "integer") && typeof value === "number") {
    const unit = String(form["x-unit"] ?? found["x-unit"] ?? unitOfKey(key));
    return {
      ...head,
      kind: "number",
      value,
      min: Number(form.minimum ?? found.minimum ?? -Infinity),
      max: Number(form.maximum ?? found.maximum ?? Infinity),
      whole: kind === "integer",
      unit: UNITS[unit] ?? unit.replaceAll("_", " "),
      fallback: typeof fallback === "number" ? fallback : null,
    };
  }
  if (kind === "boolean" && typeof value === "boolean") return { ...head, kind, value, fallback };
  const words = forms.flatMap((one) => one.enum ?? (typeof one.const === "string" ? [one.const] : []));
  if (words.length > 0 && (typeof value === "string" || (nullable && value === null))) {
    const names = words.filter((word) => typeof word === "string");
    return { ...head, kind: "choice", value: value ?? "", names: nullable ? ["", ...names] : names, fallback: fallback ?? (nullable ? "" : null) };
  }
  if (kind === "string" && typeof value === "string") {
    return { ...head, kind: "text", value, max_length: Number(form.maxLength ?? 64), fallback };
  }
  return null;
}

/** Titles of what belongs together, in the panel's order. Keys that a newer server adds come under "More". */
const GROUPS = /** @type {[string, string[]][]} */ ([
  ["Clouds", ["layers"]],
  ["Sun", ["sun"]],
  ["Wind", ["wind"]],
  ["Air", ["atmosphere"]],
  ["Light in clouds", ["light"]],
  ["Picture", ["exposure_ev", "tone"]],
  ["Ground", ["planet"]],
  ["Moon", ["moon"]],
  ["Stars", ["stars"]],
]);

/**
 * @param {Schema} openapi
 * @param {any} scene
 * @returns {{ title: string, about: string, fields: Field[] }[]}
 */
export function panelOf(openapi, scene) {
  const schema = resolve(openapi, openapi.components?.schemas?.Scene ?? {});
  const keys = keysOf(schema).filter((key) => !HIDDEN.has(key) && key !== "quality");
  const grouped = new Set(GROUPS.flatMap(([, names]) => names));
  const groups = [...GROUPS, /** @type {[string, string[]]} */ (["More", keys.filter((key) => !grouped.has(key))])];
  return groups.flatMap(([title, names]) => {
    const fields = names.flatMap((name) => {
      const property = schema.properties?.[name];
      const field = property && fieldOf(openapi, property, scene[name], [name]);
      return field ? [field] : [];
    });
    const about = fields.length === 1 ? fields[0].about : "";
    return fields.length > 0 ? [{ title, about, fields }] : [];
  });
}

/**
 * The tree without its values: as long as it is the same, rows stay and only their values change.
 * @param {{ fields: Field[] }[]} panel
 */
export function shapeOf(panel) {
  /** @param {Field} field @returns {any} */
  const shape = (field) => [
    field.kind,
    field.path.join("/"),
    ...(field.kind === "group" || field.kind === "list" ? [field.kind === "group" && field.present, field.children.map(shape)] : []),
  ];
  return JSON.stringify(panel.map(({ fields }) => fields.map(shape)));
}

/**
 * How a slider's place (0 to 1) becomes a value and back: evenly where the range is of one size, by powers where it goes over
 * many, so that what is common takes most of the way.
 * @param {{ min: number, max: number, fallback: number | null, value: number }} field
 */
export function sliderScale({ min, max, fallback, value }) {
  const typical = Math.abs(fallback || value || (max - min) / 2);
  if (min > 0 && max / min >= 1000) {
    const ratio = Math.log(max / min);
    return { valueAt: (/** @type {number} */ at) => min * Math.exp(at * ratio), placeOf: (/** @type {number} */ v) => Math.log(v / min) / ratio };
  }
  const zero = min <= 0 && max >= 0 ? 0 : min;
  const reach = Math.max(max - zero, zero - min);
  // The typical value is to stand in the middle of its side.
  const power = typical > 0 && reach / typical > 8 ? Math.log(typical / reach) / Math.log(0.5) : 1;
  const signed = (/** @type {number} */ x) => Math.sign(x) * Math.abs(x) ** power;
  const root = (/** @type {number} */ y) => Math.sign(y) * Math.abs(y) ** (1 / power);
  const [low, high] = [root((min - zero) / reach), root((max - zero) / reach)];
  return {
    valueAt: (/** @type {number} */ at) => zero + reach * signed(low + at * (high - low)),
    placeOf: (/** @type {number} */ v) => (root((v - zero) / reach) - low) / (high - low),
  };
}

/**
 * A value of a slider, rounded to what a hand can mean by it: three digits, or whole numbers.
 * @param {number} value
 * @param {boolean} whole
 */
export function rounded(value, whole) {
  return whole ? Math.round(value) : Number(value.toPrecision(3));
}
