// @ts-check
/** A WebGL2 program of two shaders. */

/**
 * Compiles, links and uses it.
 *
 * @param {WebGL2RenderingContext} gl
 * @param {string} vertex source of the vertex shader
 * @param {string} fragment source of the fragment shader
 * @returns {WebGLProgram}
 * @throws {Error} with what the driver says, where it does not link
 */
export function linkedProgram(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of /** @type {const} */ ([
    [gl.VERTEX_SHADER, vertex],
    [gl.FRAGMENT_SHADER, fragment],
  ])) {
    const shader = gl.createShader(kind);
    if (!shader) throw new Error("no shader");
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) ?? "no program");
  gl.useProgram(program);
  return program;
}
