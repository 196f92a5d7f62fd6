// @ts-check
/**
 * The cells and viewers from above: north is up.
 *
 * @typedef {object} Cell  as `/api/v1/cells` tells it, in part
 * @property {number} id
 * @property {string} name
 * @property {[number, number, number]} reference_m  x (east), altitude, z (south)
 * @property {number} radius_m
 * @property {boolean} placed  by the operator
 * @property {number[]} viewers
 *
 * @typedef {object} Viewer  as `/api/v1/viewers` tells it, in part
 * @property {number} id
 * @property {number | null} cell
 * @property {[number, number, number] | null} position_m
 * @property {number | null} yaw_deg  clockwise from north
 *
 * @typedef {object} MapCell
 * @property {number} id
 * @property {string} label
 * @property {boolean} placed
 * @property {boolean} empty
 * @property {string} colour
 * @property {number} x
 * @property {number} y
 * @property {number} radius  pixels
 *
 * @typedef {object} MapViewer
 * @property {number} id
 * @property {boolean} own
 * @property {string} label  empty where there is nothing to say
 * @property {string} colour
 * @property {number} x
 * @property {number} y
 * @property {number} yaw_rad
 * @property {MapCell | null} cell
 *
 * @typedef {object} MapLayout
 * @property {MapCell[]} cells
 * @property {MapViewer[]} viewers
 * @property {number} metres_per_pixel
 */

const ASK_EVERY_MS = 1000;
/** Around everything, pixels: room for labels. */
const MARGIN = 44;
/** A cell is never drawn smaller, pixels. */
const RADIUS_MIN = 9;
/** The least width of what is shown, m. */
const WIDTH_MIN_M = 200;
/** Altitudes that are told, m. */
const ALTITUDE_TOLD_M = 100;
const QUIET = "#9aa7b8";
const INK = "#e6ebf2";

/**
 * Neighbouring numbers get colours far apart.
 * @param {number} id
 */
export function colourOf(id) {
  return `hsl(${((id * 137.508) % 360).toFixed(0)} 70% 68%)`;
}

/**
 * A length for people.
 * @param {number} metres
 */
export function lengthText(metres) {
  return Math.abs(metres) >= 1000 ? `${Number((metres / 1000).toPrecision(3))} km` : `${Math.round(metres)} m`;
}

/**
 * The longest of 1, 2 and 5 times a power of ten that is not longer.
 * @param {number} metres
 */
export function roundLength(metres) {
  const decade = 10 ** Math.floor(Math.log10(metres));
  const step = [5, 2, 1].find((times) => times * decade <= metres) ?? 1;
  return step * decade;
}

/**
 * Where everything stands on a map of a width and height in pixels.
 * @param {Cell[]} cells
 * @param {Viewer[]} viewers
 * @param {number | null} own  the viewer who looks
 * @param {number} width
 * @param {number} height
 * @returns {MapLayout}
 */
export function layoutMap(cells, viewers, own, width, height) {
  const placed = viewers.flatMap((viewer) => (viewer.position_m ? [{ ...viewer, position_m: viewer.position_m }] : []));
  const [west, east, north, south] = [
    ...cells.map(({ reference_m: [x, , z], radius_m: r }) => [x - r, x + r, z - r, z + r]),
    ...placed.map(({ position_m: [x, , z] }) => [x, x, z, z]),
  ].reduce(
    (box, [a, b, c, d]) => [Math.min(box[0], a), Math.max(box[1], b), Math.min(box[2], c), Math.max(box[3], d)],
    [Infinity, -Infinity, Infinity, -Infinity],
  );
  const is_empty = !(west <= east);
  const middle_m = is_empty ? [0, 0] : [(west + east) / 2, (north + south) / 2];
  const span_m = is_empty ? [0, 0] : [east - west, south - north];
  const metres_per_pixel = Math.max(
    Math.max(span_m[0], WIDTH_MIN_M) / Math.max(width - 2 * MARGIN, 1),
    Math.max(span_m[1], WIDTH_MIN_M) / Math.max(height - 2 * MARGIN, 1),
  );
  /** @param {[number, number, number]} position_m */
  const at = ([x, , z]) => ({
    x: width / 2 + (x - middle_m[0]) / metres_per_pixel,
    y: height / 2 + (z - middle_m[1]) / metres_per_pixel,
  });
  const map_cells = cells.map((cell) => ({
    id: cell.id,
    label: `${cell.name} · ${cell.viewers.length}`,
    placed: cell.placed,
    empty: cell.viewers.length === 0,
    colour: colourOf(cell.id),
    radius: Math.max(cell.radius_m / metres_per_pixel, RADIUS_MIN),
    ...at(cell.reference_m),
  }));
  const map_viewers = placed.map((viewer) => {
    const cell = map_cells.find(({ id }) => id === viewer.cell) ?? null;
    const altitude_m = viewer.position_m[1];
    const altitude_text = altitude_m < ALTITUDE_TOLD_M ? "" : `${lengthText(altitude_m)} up`;
    const is_own = viewer.id === own;
    return {
      id: viewer.id,
      own: is_own,
      label: [is_own ? "you" : "", altitude_text].filter((text) => text !== "").join(", "),
      colour: cell?.colour ?? QUIET,
      yaw_rad: ((viewer.yaw_deg ?? 0) * Math.PI) / 180,
      cell,
      ...at(viewer.position_m),
    };
  });
  return { cells: map_cells, viewers: map_viewers, metres_per_pixel };
}

/**
 * Writes texts where they do not cover each other: each goes down until there is room.
 * @param {CanvasRenderingContext2D} context
 * @param {{ text: string, colour: string, x: number, y: number }[]} labels
 * @param {number} width
 * @param {number} height
 */
function drawLabels(context, labels, width, height) {
  const line = 16;
  /** @type {{ left: number, right: number, y: number }[]} */
  const taken = [];
  context.textAlign = "center";
  context.textBaseline = "middle";
  context.lineWidth = 4;
  context.strokeStyle = "#0d1117";
  for (const { text, colour, x, y } of labels) {
    const half = context.measureText(text).width / 2 + 3;
    const middle = Math.min(Math.max(x, half), Math.max(width - half, half));
    let at = Math.max(y, line / 2);
    while (
      at < height &&
      taken.some((other) => Math.abs(other.y - at) < line && middle - half < other.right && middle + half > other.left)
    )
      at += line;
    taken.push({ left: middle - half, right: middle + half, y: at });
    context.strokeText(text, middle, at);
    context.fillStyle = colour;
    context.fillText(text, middle, at);
  }
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {MapLayout} layout
 * @param {number} width
 * @param {number} height
 */
function drawMap(context, layout, width, height) {
  context.clearRect(0, 0, width, height);
  context.font = "13px system-ui, 'DejaVu Sans', sans-serif";
  for (const cell of layout.cells) {
    context.globalAlpha = cell.empty ? 0.5 : 1;
    context.strokeStyle = cell.colour;
    context.lineWidth = cell.placed ? 2.5 : 1.5;
    context.setLineDash(cell.placed ? [] : [6, 5]);
    context.beginPath();
    context.arc(cell.x, cell.y, cell.radius, 0, 2 * Math.PI);
    context.stroke();
    context.setLineDash([]);
    // The reference point.
    context.beginPath();
    context.moveTo(cell.x - 6, cell.y);
    context.lineTo(cell.x + 6, cell.y);
    context.moveTo(cell.x, cell.y - 6);
    context.lineTo(cell.x, cell.y + 6);
    context.stroke();
  }
  context.globalAlpha = 1;
  for (const viewer of layout.viewers) {
    if (viewer.cell) {
      context.globalAlpha = 0.45;
      context.strokeStyle = viewer.colour;
      context.lineWidth = 1;
      context.beginPath();
      context.moveTo(viewer.x, viewer.y);
      context.lineTo(viewer.cell.x, viewer.cell.y);
      context.stroke();
      context.globalAlpha = 1;
    }
    // Where the viewer looks: yaw turns clockwise from up.
    context.fillStyle = viewer.colour;
    context.globalAlpha = 0.35;
    context.beginPath();
    context.moveTo(viewer.x, viewer.y);
    context.arc(viewer.x, viewer.y, 20, viewer.yaw_rad - Math.PI / 2 - 0.5, viewer.yaw_rad - Math.PI / 2 + 0.5);
    context.fill();
    context.globalAlpha = 1;
    context.beginPath();
    context.arc(viewer.x, viewer.y, 4.5, 0, 2 * Math.PI);
    context.fill();
    if (viewer.own) {
      context.strokeStyle = INK;
      context.lineWidth = 2;
      context.stroke();
    }
  }
  drawLabels(
    context,
    [
      ...layout.cells.map(({ label, colour, x, y, radius }) => ({ text: label, colour, x, y: y - radius - 10 })),
      ...layout.viewers
        .filter(({ label }) => label !== "")
        .map(({ label, x, y }) => ({ text: label, colour: INK, x, y: y + 16 })),
    ],
    width,
    height,
  );
  drawScale(context, layout.metres_per_pixel, height);
}

/**
 * @param {CanvasRenderingContext2D} context
 * @param {number} metres_per_pixel
 * @param {number} height
 */
function drawScale(context, metres_per_pixel, height) {
  const length_m = roundLength(140 * metres_per_pixel);
  const right = 12 + length_m / metres_per_pixel;
  const y = height - 12;
  context.strokeStyle = QUIET;
  context.lineWidth = 1.5;
  context.beginPath();
  context.moveTo(12, y - 5);
  context.lineTo(12, y);
  context.lineTo(right, y);
  context.lineTo(right, y - 5);
  context.stroke();
  context.fillStyle = QUIET;
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  context.fillText(`${lengthText(length_m)}, north is up`, 16, y - 6);
}

/**
 * @template T
 * @param {string} path
 * @returns {Promise<T[]>}
 */
async function list(path) {
  const answer = await fetch(path);
  if (!answer.ok) throw new Error(`${path}: ${answer.status}`);
  return /** @type {T[]} */ (await answer.json());
}

/** @param {number} count @param {string} what */
function counted(count, what) {
  return `${count} ${what}${count === 1 ? "" : "s"}`;
}

/**
 * Shows the map while its button is pressed. Nothing is asked for before.
 * @param {object} parts
 * @param {HTMLElement} parts.panel
 * @param {HTMLCanvasElement} parts.canvas
 * @param {HTMLElement} parts.told
 * @param {HTMLButtonElement} parts.opener
 * @param {() => number | null} parts.ownViewer
 */
export function attachCellMap({ panel, canvas, told, opener, ownViewer }) {
  /** @type {MapLayout | null} */
  let shown = null;
  /** @type {ReturnType<typeof setTimeout> | undefined} */
  let timer;

  async function refresh() {
    try {
      const [cells, viewers] = await Promise.all([
        /** @type {Promise<Cell[]>} */ (list("api/v1/cells")),
        /** @type {Promise<Viewer[]>} */ (list("api/v1/viewers")),
      ]);
      if (panel.hidden) return;
      const { clientWidth: width, clientHeight: height } = canvas;
      const scale = window.devicePixelRatio || 1;
      canvas.width = Math.round(width * scale);
      canvas.height = Math.round(height * scale);
      const context = canvas.getContext("2d");
      if (!context) return;
      context.setTransform(scale, 0, 0, scale, 0, 0);
      shown = layoutMap(cells, viewers, ownViewer(), width, height);
      drawMap(context, shown, width, height);
      told.textContent = `${counted(shown.cells.length, "cell")}, ${counted(shown.viewers.length, "viewer")}`;
    } catch {
      told.textContent = "The server does not tell where cells and viewers are.";
    }
    if (!panel.hidden) timer = setTimeout(refresh, ASK_EVERY_MS);
  }

  /** @param {boolean} is_open */
  function show(is_open) {
    panel.hidden = !is_open;
    opener.setAttribute("aria-expanded", String(is_open));
    clearTimeout(timer);
    shown = null;
    if (is_open) void refresh();
  }

  opener.addEventListener("click", () => show(panel.hidden));
  window.addEventListener("keydown", (event) => {
    if (event.key === "Escape" && !panel.hidden) {
      show(false);
      opener.focus();
    }
  });
  return {
    /** What the map shows; null while it is closed. */
    shown: () => shown,
  };
}
