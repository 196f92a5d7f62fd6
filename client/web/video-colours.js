// @ts-check
/**
 * Turns the planes of a decoded video into pixels, where the server has spread its colours over their eight bits
 * (`protocol/src/colour_scale.rs`): colour differences are put back, slow slopes smoothed, and the pixels dithered as a PNG's
 * are, by the graphics card. Browsers would show such a video with colours several times too strong.
 */

import { linkedProgram } from "./gl-program.js";

/** @typedef {import("./frame-header.js").FrameHeader} FrameHeader */
/** @typedef {NonNullable<FrameHeader["colours"]>} Colours */

const VERTEX = `#version 300 es
void main() {
  // One triangle over everything.
  gl_Position = vec4(gl_VertexID == 1 ? 3.0 : -1.0, gl_VertexID == 2 ? 3.0 : -1.0, 0.0, 1.0);
}`;

const FRAGMENT = `#version 300 es
precision highp float;
uniform highp sampler2D luma;
/** Differences, filtered; both of them in the first where they come in pairs. */
uniform highp sampler2D blue;
uniform highp sampler2D red;
uniform bool in_pairs;
uniform float height;
/** One eye's columns: the pattern begins anew there. */
uniform float eye_width;
uniform vec2 centre;
uniform float gain;
out vec4 colour;
const ivec2 AROUND[12] = ivec2[12](
  ivec2(0, -8), ivec2(-4, -4), ivec2(0, -4), ivec2(4, -4), ivec2(-8, 0), ivec2(-4, 0),
  ivec2(4, 0), ivec2(8, 0), ivec2(-4, 4), ivec2(0, 4), ivec2(4, 4), ivec2(0, 8));
void main() {
  vec2 pixel = vec2(gl_FragCoord.x, height - gl_FragCoord.y);
  // A slope of brightness too slow for eight bits is a slope again: the mean of what is around and differs by a step at most.
  ivec2 at = ivec2(pixel);
  ivec2 last = textureSize(luma, 0) - 1;
  float own = texelFetch(luma, at, 0).r;
  vec2 sum = vec2(own, 1.0);
  for (int i = 0; i < 12; i += 1) {
    float value = texelFetch(luma, clamp(at + AROUND[i], ivec2(0), last), 0).r;
    if (abs(value - own) < 1.5 / 255.0) sum += vec2(value, 1.0);
  }
  float y = sum.x / sum.y * 255.0;
  // A difference stands in the middle of 2 x 2 pixels.
  vec2 place = 0.5 * pixel / vec2(textureSize(blue, 0));
  vec2 pair = texture(blue, place).rg;
  vec2 d = (vec2(pair.r, in_pairs ? pair.g : texture(red, place).r) * 255.0 - 128.0) / gain + centre - 128.0;
  // BT.709, full range.
  vec3 rgb = y + vec3(1.5748 * d.y, -0.187324 * d.x - 0.468124 * d.y, 1.8556 * d.x);
  vec2 corner = vec2(mod(floor(pixel.x), eye_width), floor(pixel.y));
  float pattern = fract(52.9829189 * fract(dot(corner, vec2(0.06711056, 0.00583715)))) - 0.5;
  colour = vec4((rgb + pattern) / 255.0, 1.0);
}`;

/**
 * Whether this browser can do it: it lets read a video's planes and draw by shaders.
 * @returns {boolean}
 */
export function canSpreadColours() {
  if (typeof VideoFrame !== "function" || typeof VideoFrame.prototype.copyTo !== "function") return false;
  return typeof OffscreenCanvas === "function" && new OffscreenCanvas(1, 1).getContext("webgl2") !== null;
}

/**
 * @param {WebGL2RenderingContext} gl
 */
function link(gl) {
  const program = linkedProgram(gl, VERTEX, FRAGMENT);
  const at = (/** @type {string} */ name) => gl.getUniformLocation(program, name);
  ["luma", "blue", "red"].forEach((name, unit) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.LINEAR);
    gl.uniform1i(at(name), unit);
  });
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
  return {
    in_pairs: at("in_pairs"),
    height: at("height"),
    eye_width: at("eye_width"),
    centre: at("centre"),
    gain: at("gain"),
  };
}

/**
 * @returns {(picture: VideoFrame, header: FrameHeader, colours: Colours) => Promise<ImageBitmap>}  leaves the picture open; for one
 *   at a time; rejects where the picture's planes cannot be read
 */
export function createColourReader() {
  const canvas = new OffscreenCanvas(1, 1);
  const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false });
  if (!gl) throw new Error("no WebGL2");
  let uniforms = link(gl);
  canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
  canvas.addEventListener("webglcontextrestored", () => {
    uniforms = link(gl);
  });
  let bytes = new Uint8Array(0);

  return async (picture, { width, height, stereo }, { centre, gain }) => {
    const { format, visibleRect } = picture;
    if (!visibleRect || (format !== "I420" && format !== "NV12")) throw new Error(`planes of the format ${format}`);
    const length = picture.allocationSize();
    if (bytes.length < length) bytes = new Uint8Array(length);
    const planes = await picture.copyTo(bytes);
    const in_pairs = format === "NV12";
    const half = { width: Math.ceil(visibleRect.width / 2), height: Math.ceil(visibleRect.height / 2) };
    planes.forEach(({ offset, stride }, unit) => {
      const side = unit === 0 ? visibleRect : half;
      const is_pair = unit > 0 && in_pairs;
      const [internal, external] = is_pair ? [gl.RG8, gl.RG] : [gl.R8, gl.RED];
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.pixelStorei(gl.UNPACK_ROW_LENGTH, is_pair ? stride / 2 : stride);
      gl.texImage2D(gl.TEXTURE_2D, 0, internal, side.width, side.height, 0, external, gl.UNSIGNED_BYTE, bytes, offset);
    });
    if (canvas.width !== width) canvas.width = width;
    if (canvas.height !== height) canvas.height = height;
    gl.viewport(0, 0, width, height);
    gl.uniform1i(uniforms.in_pairs, in_pairs ? 1 : 0);
    gl.uniform1f(uniforms.height, height);
    gl.uniform1f(uniforms.eye_width, stereo ? width / 2 : width);
    gl.uniform2fv(uniforms.centre, centre);
    gl.uniform1f(uniforms.gain, gain);
    gl.drawArrays(gl.TRIANGLES, 0, 3);
    return canvas.transferToImageBitmap();
  };
}
