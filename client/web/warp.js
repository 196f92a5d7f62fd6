// @ts-check
/**
 * Draws pictures of the sky, turned to a newer camera. A picture of far away things holds for every rotation about its eye:
 * a pixel of the new camera is a direction, and that direction is somewhere in the picture. So a page shows a turn at once,
 * out of the last picture, while the next one is on its way.
 *
 * Takes whatever a browser can draw (an ImageBitmap, a VideoFrame, a canvas). Without WebGL2 it draws as it is, unturned.
 */

import { linkedProgram } from "./gl-program.js";

/** @typedef {import("./look.js").Camera} Camera */
/** @typedef {{ width: number, height: number }} Size */
/** @typedef {ImageBitmap | VideoFrame | HTMLCanvasElement | HTMLImageElement | HTMLVideoElement | OffscreenCanvas} Picture */

/**
 * @typedef {object} Warp  from pixels of the camera that is shown to those of the picture
 * @property {number[]} picture_from_shown  rotation between the two cameras' axes (right, up, ahead), 3 × 3 by columns
 * @property {[number, number]} shown_tan  tangents of half the shown angles, across and up
 * @property {[number, number]} picture_tan  the same of the picture
 */

/**
 * @typedef {object} Painter
 * @property {"webgl2" | "2d"} kind  "2d" cannot turn pictures
 * @property {(picture: Picture, size: Size) => void} load  the picture that is painted from now on
 * @property {(size: Size, warp: Warp | null) => void} paint  null: the picture as it is
 */

const DEG = Math.PI / 180;

/**
 * Right, up and ahead of a camera in the world (x east, y up, z south).
 * @param {Camera} camera
 * @returns {[number[], number[], number[]]}
 */
export function axes({ yaw_deg, pitch_deg }) {
  const [sy, cy] = [Math.sin(yaw_deg * DEG), Math.cos(yaw_deg * DEG)];
  const [sp, cp] = [Math.sin(pitch_deg * DEG), Math.cos(pitch_deg * DEG)];
  return [
    [cy, 0, sy],
    [-sy * sp, cp, cy * sp],
    [sy * cp, sp, -cy * cp],
  ];
}

/**
 * Tangents of half the angles that a camera sees, across and up.
 * @param {Camera} camera
 * @param {Size} size
 * @returns {[number, number]}
 */
export function halfTangents({ vertical_fov_deg }, { width, height }) {
  const up = Math.tan((vertical_fov_deg / 2) * DEG);
  return [(up * width) / height, up];
}

/**
 * Columns of the rotation from one camera's axes to another's.
 * @param {number[][]} from  right, up and ahead in the world
 * @param {number[][]} to
 */
export function rotationBetween(from, to) {
  return from.flatMap((axis) => to.map((row) => row[0] * axis[0] + row[1] * axis[1] + row[2] * axis[2]));
}

/**
 * How a picture is to be read to show what another camera at the same place sees.
 * @param {Camera} picture_camera
 * @param {Size} picture_size
 * @param {Camera} shown_camera
 * @param {Size} shown_size
 * @returns {Warp}
 */
export function warpBetween(picture_camera, picture_size, shown_camera, shown_size) {
  return {
    picture_from_shown: rotationBetween(axes(shown_camera), axes(picture_camera)),
    shown_tan: halfTangents(shown_camera, shown_size),
    picture_tan: halfTangents(picture_camera, picture_size),
  };
}

/**
 * Where in the picture (0 to 1 from its upper left corner) a place of the shown one is; outside of 0 to 1 it holds nothing.
 * The shader's twin.
 * @param {Warp} warp
 * @param {number} x  0 to 1, to the right
 * @param {number} y  0 to 1, downwards
 * @returns {[number, number]}
 */
export function lookUp({ picture_from_shown: m, shown_tan, picture_tan }, x, y) {
  const ray = [(2 * x - 1) * shown_tan[0], (1 - 2 * y) * shown_tan[1], 1];
  const [right, up, ahead] = [0, 1, 2].map((row) => m[row] * ray[0] + m[3 + row] * ray[1] + m[6 + row] * ray[2]);
  const depth = Math.max(ahead, 1e-3);
  return [0.5 + right / depth / picture_tan[0] / 2, 0.5 - up / depth / picture_tan[1] / 2];
}

/**
 * The camera and the size to ask for so that there is something beyond the edges to turn to. The asked picture's scale is that
 * of the shown one.
 * @param {Camera} camera
 * @param {Size} size
 * @param {number} margin  0.15: 15 % wider and higher
 * @param {Size} max
 * @returns {{ camera: Camera, size: Size }}
 */
export function withMargin(camera, size, margin, max) {
  const grown = (/** @type {number} */ pixels, /** @type {number} */ limit) =>
    Math.max(pixels, Math.min(2 * Math.round((pixels * (1 + margin)) / 2), 2 * Math.floor(limit / 2)));
  const asked = { width: grown(size.width, max.width), height: grown(size.height, max.height) };
  const up = (Math.tan((camera.vertical_fov_deg / 2) * DEG) * asked.height) / size.height;
  return { camera: { ...camera, vertical_fov_deg: Math.min(170, (2 * Math.atan(up)) / DEG) }, size: asked };
}

const VERTEX = `#version 300 es
out vec2 place;
void main() {
  // One triangle over everything.
  vec2 corner = vec2(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0);
  place = corner;
  gl_Position = vec4(corner, 0.0, 1.0);
}`;

/**
 * For shaders of others, too: `look_up(place)` is where in the picture (its first row at 0) a place of the shown one is, -1 to 1
 * to the right and up. Beyond the picture's edge a texture that is clamped goes on with its last pixels.
 */
export const LOOK_UP_GLSL = `
uniform mat3 picture_from_shown;
uniform vec2 shown_tan;
uniform vec2 picture_tan;
vec2 look_up(vec2 place) {
  vec3 ray = picture_from_shown * vec3(place * shown_tan, 1.0);
  return 0.5 + vec2(0.5, -0.5) * ray.xy / max(ray.z, 1e-3) / picture_tan;
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform sampler2D picture;
in vec2 place;
out vec4 colour;
${LOOK_UP_GLSL}
void main() {
  colour = vec4(texture(picture, look_up(place)).rgb, 1.0);
}`;

/** @type {Warp} */
const AS_IT_IS = { picture_from_shown: [1, 0, 0, 0, 1, 0, 0, 0, 1], shown_tan: [1, 1], picture_tan: [1, 1] };

/**
 * @param {WebGL2RenderingContext} gl
 * @returns {(warp: Warp) => void}
 */
function program(gl) {
  const linked = linkedProgram(gl, VERTEX, FRAGMENT);
  gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
  for (const [name, value] of [
    [gl.TEXTURE_MIN_FILTER, gl.LINEAR],
    [gl.TEXTURE_MAG_FILTER, gl.LINEAR],
    [gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE],
    [gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE],
  ]) {
    gl.texParameteri(gl.TEXTURE_2D, name, value);
  }
  gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
  const matrix = gl.getUniformLocation(linked, "picture_from_shown");
  const shown = gl.getUniformLocation(linked, "shown_tan");
  const picture = gl.getUniformLocation(linked, "picture_tan");
  return ({ picture_from_shown, shown_tan, picture_tan }) => {
    gl.uniformMatrix3fv(matrix, false, picture_from_shown);
    gl.uniform2fv(shown, shown_tan);
    gl.uniform2fv(picture, picture_tan);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
  };
}

/**
 * Setting a canvas' size clears it, even to the same size.
 * @param {HTMLCanvasElement | OffscreenCanvas} canvas
 * @param {Size} size
 */
function resize(canvas, { width, height }) {
  if (canvas.width !== width) canvas.width = width;
  if (canvas.height !== height) canvas.height = height;
}

/**
 * A painter on a canvas that has no context yet.
 * @param {HTMLCanvasElement} canvas
 * @returns {Painter}
 */
export function createPainter(canvas) {
  // What is drawn stays readable, for screenshots.
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, preserveDrawingBuffer: true });
  return gl ? glPainter(canvas, gl) : plainPainter(canvas);
}

/**
 * @param {HTMLCanvasElement} canvas
 * @param {WebGL2RenderingContext} gl
 * @returns {Painter}
 */
function glPainter(canvas, gl) {
  let draw = program(gl);
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => {
    draw = program(gl); // the next frame brings a picture
  });
  return {
    kind: "webgl2",
    load(picture) {
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, picture);
    },
    paint(size, warp) {
      resize(canvas, size);
      gl.viewport(0, 0, size.width, size.height);
      draw(warp ?? AS_IT_IS);
    },
  };
}

/**
 * @param {HTMLCanvasElement} canvas
 * @returns {Painter}
 */
function plainPainter(canvas) {
  const context = canvas.getContext("2d", { alpha: false });
  if (!context) throw new Error("this browser gives no canvas");
  return {
    kind: "2d",
    load(picture, size) {
      resize(canvas, size);
      context.drawImage(picture, 0, 0, size.width, size.height);
    },
    paint() {},
  };
}
