// @ts-check
/**
 * Views of one quantity instead of the picture: the picker's entries and the legend of a scale.
 *
 * @typedef {object} Scale
 * @property {number} low
 * @property {number} high
 * @property {string} unit  "" for shares and counts
 * @property {boolean} logarithmic
 *
 * @typedef {object} ShowReport  as `/api/v1/views` tells it
 * @property {string} name
 * @property {string} label
 * @property {Scale | null} scale  null where colours are those of light
 * @property {boolean} cached_only
 */

/** Coefficients of viridis by a polynomial of degree six, as in `colour_scale.wgsl`. */
const VIRIDIS = [
  [0.2777273272, 0.0054073445, 0.3340998053],
  [0.1050930431, 1.4046135299, 1.3845901626],
  [-0.3308618287, 0.2148475595, 0.095095163],
  [-4.634230499, -5.7991009734, -19.3324409563],
  [6.2282699363, 14.1799333668, 56.6905526007],
  [4.7763849977, -13.7451453777, -65.3530326334],
  [-5.4354558559, 4.6458526122, 26.3124352496],
];

/**
 * The colour of a share of the scale, 0 to 255.
 * @param {number} share
 */
export function viridis(share) {
  const t = Math.min(1, Math.max(0, share));
  return [0, 1, 2].map((channel) => {
    const value = VIRIDIS.reduceRight((sum, terms) => sum * t + terms[channel], 0);
    return Math.round(255 * Math.min(1, Math.max(0, value)));
  });
}

/**
 * What stands at a share of the bar, for people.
 * @param {Scale} scale
 * @param {number} share
 */
export function tick(scale, share) {
  const { low, high, unit, logarithmic } = scale;
  const value = logarithmic ? low * (high / low) ** share : low + share * (high - low);
  const digits = value === 0 || Math.abs(value) >= 100 ? 0 : Math.abs(value) >= 10 ? 1 : 2;
  const text = String(Number(value.toFixed(digits)));
  return unit === "" ? text : `${text} ${unit}`;
}

/**
 * Draws a scale as a bar from left to right.
 * @param {HTMLCanvasElement} bar
 */
export function drawBar(bar) {
  const context = bar.getContext("2d");
  if (!context) return;
  for (let x = 0; x < bar.width; x += 1) {
    const [red, green, blue] = viridis((x + 0.5) / bar.width);
    context.fillStyle = `rgb(${red} ${green} ${blue})`;
    context.fillRect(x, 0, 1, bar.height);
  }
}

/** The views that the server knows; none where it does not answer. */
export async function fetchViews() {
  try {
    const answer = await fetch("api/v1/views");
    if (!answer.ok) return [];
    return /** @type {ShowReport[]} */ (await answer.json());
  } catch {
    return [];
  }
}
