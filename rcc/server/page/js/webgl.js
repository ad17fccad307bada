// A renderer of lit meshes and of lines, on WebGL. It knows nothing of robots.

/** @typedef {import("./math3.js").Matrix} Matrix */
/** @typedef {{ buffers: WebGLBuffer[], count: number }} Drawn what lies in the memory of the graphics processor */
/** Red, green, blue, from 0 to 1. @typedef {number[]} Colour */

const MESH = `attribute vec3 position, normal; uniform mat4 view, model; varying vec3 facing, at;
void main() { vec4 world = model * vec4(position, 1.0); at = world.xyz; facing = mat3(model) * normal; gl_Position = view * world; }`;
const LIT = `precision mediump float; varying vec3 facing, at; uniform vec4 colour; uniform vec3 eye; uniform float ambient;
void main() { vec3 n = normalize(facing), sight = normalize(eye - at);
  float sun = max(dot(n, vec3(0.36, -0.48, 0.8)), 0.0), sky = 0.5 + 0.5 * n.z, edge = pow(1.0 - max(dot(n, sight), 0.0), 3.0);
  float gloss = pow(max(dot(reflect(-sight, n), vec3(0.36, -0.48, 0.8)), 0.0), 24.0);
  gl_FragColor = vec4(colour.rgb * (ambient * sky + (1.0 - ambient) * sun + 0.12) + 0.16 * gloss + 0.10 * edge, colour.a); }`;
const LINES = `attribute vec3 position; uniform mat4 view, model; void main() { gl_Position = view * model * vec4(position, 1.0); }`;
const FLAT = `precision mediump float; uniform vec4 colour; void main() { gl_FragColor = colour; }`;

/** Largest scale of the display's pixels that is drawn. */
const SCALE_MAX = 2;

/** @param {WebGLRenderingContext} gl @param {string} vertex @param {string} fragment */
function link(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, text] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]])) {
    const shader = gl.createShader(kind);
    if (!program || !shader) throw new Error("WebGL gives no memory for shaders");
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.bindAttribLocation(/** @type {WebGLProgram} */ (program), 0, "position");
  gl.linkProgram(/** @type {WebGLProgram} */ (program));
  if (!gl.getProgramParameter(/** @type {WebGLProgram} */ (program), gl.LINK_STATUS) && !gl.isContextLost())
    throw new Error("WebGL cannot link a shader: " + gl.getProgramInfoLog(/** @type {WebGLProgram} */ (program)));
  /** @param {string} name */
  const uniform = name => gl.getUniformLocation(/** @type {WebGLProgram} */ (program), name);
  return { program, view: uniform("view"), model: uniform("model"), colour: uniform("colour"), eye: uniform("eye"), ambient: uniform("ambient"),
    normal: gl.getAttribLocation(/** @type {WebGLProgram} */ (program), "normal") };
}

/** Names of renderers that have no graphics processor. */
const SOFTWARE = /swiftshader|llvmpipe|softpipe|software|basic render/i;

/** By the name of the renderer: not every browser that draws in software says that it is slow. */
function drawsInSoftware() {
  const gl = document.createElement("canvas").getContext("webgl"), info = gl?.getExtension("WEBGL_debug_renderer_info");
  const name = gl?.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
  gl?.getExtension("WEBGL_lose_context")?.loseContext();
  return SOFTWARE.test(String(name));
}

/** Least detail, and the factor of one step. */
const DETAIL_MIN = 0.5, DETAIL_STEP = 0.8;

export class Renderer {
  /** Throws if the browser has no WebGL. @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    /** Whether the browser draws without a graphics processor: it has no time for smooth edges and many corners. */
    this.isSoftware = drawsInSoftware();
    const gl = canvas.getContext("webgl", { alpha: false, antialias: !this.isSoftware, powerPreference: "low-power" });
    if (!gl) throw new Error("This browser has no WebGL.\nhint: enable it, or use the tables of the other views");
    this.canvas = canvas;
    this.gl = gl;
    /** Pixels drawn for each pixel of the display: fewer where pictures take too long. */
    this.detail = 1;
    this.mesh = link(gl, MESH, LIT);
    this.line = link(gl, LINES, FLAT);
    /** @type {Matrix} */ this.view = new Float64Array(16);
    /** @type {ReturnType<typeof link> | null} */ this.used = null;
    /** @type {Drawn | null} */ this.bound = null;
    gl.enable(gl.DEPTH_TEST);
    gl.depthFunc(gl.LEQUAL);
    gl.enable(gl.CULL_FACE);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.polygonOffset(1, 2);
  }

  /** Draws with more detail from now on. */
  refine() { this.detail = Math.min(1, this.detail / DETAIL_STEP); }

  /** Draws with less detail from now on; whether there was any left to save. */
  coarsen() {
    const before = this.detail;
    this.detail = Math.max(DETAIL_MIN, before * DETAIL_STEP);
    return this.detail < before;
  }

  /** @param {number} kind @param {BufferSource} data */
  buffer(kind, data) {
    const buffer = this.gl.createBuffer();
    this.gl.bindBuffer(kind, buffer);
    this.gl.bufferData(kind, data, this.gl.STATIC_DRAW);
    return /** @type {WebGLBuffer} */ (buffer);
  }

  /** @param {{ positions: ArrayLike<number>, normals: ArrayLike<number>, indices: ArrayLike<number> }} mesh @returns {Drawn} */
  load(mesh) {
    const { gl } = this;
    this.bound = null;
    return { count: mesh.indices.length, buffers: [this.buffer(gl.ARRAY_BUFFER, new Float32Array(mesh.positions)),
      this.buffer(gl.ARRAY_BUFFER, new Float32Array(mesh.normals)), this.buffer(gl.ELEMENT_ARRAY_BUFFER, new Uint16Array(mesh.indices))] };
  }

  /** Lines of two points each, or the points of a strip. @param {ArrayLike<number>} points @returns {Drawn} */
  loadLines(points) {
    this.bound = null;
    return { count: points.length / 3, buffers: [this.buffer(this.gl.ARRAY_BUFFER, new Float32Array(points))] };
  }

  /** Replaces the points of lines. @param {Drawn} lines @param {Float32Array} points */
  replaceLines(lines, points) {
    this.bound = null;
    lines.count = points.length / 3;
    this.gl.bindBuffer(this.gl.ARRAY_BUFFER, lines.buffers[0]);
    this.gl.bufferData(this.gl.ARRAY_BUFFER, points, this.gl.DYNAMIC_DRAW);
  }

  /** @param {Drawn} drawn */
  release(drawn) {
    drawn.buffers.forEach(buffer => this.gl.deleteBuffer(buffer));
    this.bound = null;
  }

  /** Begins a picture as large as the canvas is shown. @param {Matrix} view projection times view @param {number[]} eye
   * @param {Colour} back @param {number} ambient 0 to 1: light from all sides */
  begin(view, eye, back, ambient) {
    const { gl, canvas } = this, scale = this.detail * Math.min(SCALE_MAX, devicePixelRatio || 1);
    const [width, height] = [Math.max(1, Math.round(canvas.clientWidth * scale)), Math.max(1, Math.round(canvas.clientHeight * scale))];
    if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
    gl.viewport(0, 0, width, height);
    gl.depthMask(true);
    gl.clearColor(back[0], back[1], back[2], 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    this.used = this.bound = null;
    this.view = view;
    gl.useProgram(this.mesh.program);
    gl.uniform3f(this.mesh.eye, eye[0], eye[1], eye[2]);
    gl.uniform1f(this.mesh.ambient, ambient);
  }

  /** @param {ReturnType<typeof link>} program @param {Matrix} model @param {Colour} colour @param {number} alpha */
  use(program, model, colour, alpha) {
    const { gl } = this;
    if (this.used !== program) {
      gl.useProgram(program.program);
      gl.uniformMatrix4fv(program.view, false, new Float32Array(this.view));
      gl.enableVertexAttribArray(0);
      if (program.normal > 0) gl.enableVertexAttribArray(program.normal);
      else gl.disableVertexAttribArray(1);
      this.used = program;
      this.bound = null;
    }
    gl.uniformMatrix4fv(program.model, false, new Float32Array(model));
    gl.uniform4f(program.colour, colour[0], colour[1], colour[2], alpha);
    (alpha < 1 ? gl.enable : gl.disable).call(gl, gl.BLEND);
  }

  /** Whether what is drawn hides what is drawn later behind it. @param {boolean} on */
  hide(on) { this.gl.depthMask(on); }

  /** Draws a mesh. What is translucent lies a little behind what is at the same place. @param {Drawn} mesh @param {Matrix} model
   * @param {Colour} colour @param {number} [alpha] */
  draw(mesh, model, colour, alpha = 1) {
    const { gl } = this;
    this.use(this.mesh, model, colour, alpha);
    (alpha < 1 ? gl.enable : gl.disable).call(gl, gl.POLYGON_OFFSET_FILL);
    if (this.bound !== mesh) {
      gl.bindBuffer(gl.ARRAY_BUFFER, mesh.buffers[1]);
      gl.vertexAttribPointer(this.mesh.normal, 3, gl.FLOAT, false, 0, 0);
      gl.bindBuffer(gl.ARRAY_BUFFER, mesh.buffers[0]);
      gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, mesh.buffers[2]);
      this.bound = mesh;
    }
    gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_SHORT, 0);
  }

  /** @param {Drawn} lines @param {Matrix} model @param {Colour} colour @param {number} [alpha] @param {boolean} [isStrip] */
  drawLines(lines, model, colour, alpha = 1, isStrip = false) {
    const { gl } = this;
    this.use(this.line, model, colour, alpha);
    gl.bindBuffer(gl.ARRAY_BUFFER, lines.buffers[0]);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.drawArrays(isStrip ? gl.LINE_STRIP : gl.LINES, 0, lines.count);
    this.bound = null;
  }
}
