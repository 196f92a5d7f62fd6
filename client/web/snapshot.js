// @ts-check
/** The picture as a file. */

/**
 * A name that sorts by time.
 * @param {Date} date
 */
export function fileName(date) {
  return `skycell-${date.toISOString().slice(0, 19).replaceAll(":", "")}Z.png`;
}

/**
 * Saves what the canvas shows.
 * @param {HTMLCanvasElement} canvas
 * @returns {Promise<string>} the file's name
 */
export async function savePicture(canvas) {
  const blob = await new Promise((/** @type {(blob: Blob | null) => void} */ resolve) => canvas.toBlob(resolve, "image/png"));
  if (!blob) throw new Error("there is no picture to save");
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = fileName(new Date());
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10_000);
  return link.download;
}
