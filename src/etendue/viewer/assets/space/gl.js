// Triangles, lines and points in WebGL 2: flat shading, wire, colours for both sides, the triangle under a pixel.

const TRIANGLES = [`#version 300 es
in vec3 position; in vec4 front; in vec4 back;
uniform mat4 view;
out vec3 place; out vec3 corner; flat out vec4 ahead; flat out vec4 behind; flat out uint number;
void main() {
  place = position; ahead = front; behind = back;
  int k = gl_VertexID % 3;
  corner = vec3(k == 0, k == 1, k == 2);
  number = uint(gl_VertexID / 3) + 1u;
  gl_Position = view * vec4(position, 1.0);
}`, `#version 300 es
precision highp float;
in vec3 place; in vec3 corner; flat in vec4 ahead; flat in vec4 behind; flat in uint number;
uniform vec3 eye; uniform vec3 ink; uniform int mode; uniform float shade;
out vec4 colour;
void main() {
  if (mode == 3) {
    colour = vec4(float(number & 255u), float((number >> 8) & 255u), float((number >> 16) & 255u), 255.0) / 255.0;
    return;
  }
  vec3 normal = normalize(cross(dFdx(place), dFdy(place)));
  float lit = mix(1.0, 0.4 + 0.6 * abs(dot(normal, normalize(eye - place))), shade);
  vec3 edges = smoothstep(vec3(0.0), 1.3 * fwidth(corner), corner);
  float line = 1.0 - min(min(edges.x, edges.y), edges.z);
  vec3 own = (gl_FrontFacing ? ahead : behind).rgb * lit;
  if (mode == 1) {
    if (line < 0.35) discard;
    colour = vec4(ink, 0.75);
  } else {
    colour = vec4(mode == 2 ? mix(own, ink, 0.45 * line) : own, 1.0);
  }
}`];

const PLAIN = [`#version 300 es
in vec3 position; in vec4 front;
uniform mat4 view; uniform float size;
out vec4 own;
void main() { own = front; gl_Position = view * vec4(position, 1.0); gl_PointSize = size; }`, `#version 300 es
precision mediump float;
in vec4 own; uniform bool round;
out vec4 colour;
void main() {
  if (round && length(gl_PointCoord - 0.5) > 0.5) discard;
  colour = own;
}`];

export class Drawing {
  constructor(canvas) {
    this.canvas = canvas;
    this.gl = canvas.getContext('webgl2', { antialias: true, alpha: false, preserveDrawingBuffer: true });
    if (!this.gl) throw new Error('this browser has no WebGL 2, which the 3-D view needs');
    this.programs = { triangles: this.program(TRIANGLES), plain: this.program(PLAIN) };
    this.layers = new Map();
    this.mode = 2;
    this.shade = 1;
    this.culled = true;
  }

  program([vertex, fragment]) {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    ['position', 'front', 'back'].forEach((name, index) => gl.bindAttribLocation(program, index, name));
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program) || 'a shader cannot be compiled');
    const uniforms = new Proxy({}, { get: (known, name) => (known[name] ??= gl.getUniformLocation(program, name)) });
    return { program, uniforms };
  }

  /** Set a layer: kind 'triangles', 'lines' or 'points', positions (Float32Array), colours (Uint8Array, four a vertex). */
  set(name, kind, positions, front, back = null, options = {}) {
    const { gl } = this;
    this.remove(name);
    if (!positions.length) return;
    const array = gl.createVertexArray();
    gl.bindVertexArray(array);
    const buffers = [];
    const attribute = (index, data, size, type, normalized) => {
      const buffer = gl.createBuffer();
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.DYNAMIC_DRAW);
      gl.enableVertexAttribArray(index);
      gl.vertexAttribPointer(index, size, type, normalized, 0, 0);
      buffers.push(buffer);
    };
    attribute(0, positions, 3, gl.FLOAT, false);
    attribute(1, front, 4, gl.UNSIGNED_BYTE, true);
    attribute(2, back ?? front, 4, gl.UNSIGNED_BYTE, true);
    gl.bindVertexArray(null);
    this.layers.set(name, { kind, array, buffers, positions, count: positions.length / 3, ...options });
  }

  recolour(name, front, back = null) {
    const { gl } = this;
    const layer = this.layers.get(name);
    if (!layer) return;
    [front, back ?? front].forEach((data, index) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, layer.buffers[index + 1]);
      gl.bufferSubData(gl.ARRAY_BUFFER, 0, data);
    });
  }

  remove(name) {
    const layer = this.layers.get(name);
    if (!layer) return;
    for (const buffer of layer.buffers) this.gl.deleteBuffer(buffer);
    this.gl.deleteVertexArray(layer.array);
    this.layers.delete(name);
  }

  fit() {
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    const width = Math.max(1, Math.round(this.canvas.clientWidth * ratio));
    const height = Math.max(1, Math.round(this.canvas.clientHeight * ratio));
    if (this.canvas.width !== width || this.canvas.height !== height) [this.canvas.width, this.canvas.height] = [width, height];
  }

  draw(view, eye, page, ink) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    this.fit();
    gl.viewport(0, 0, this.canvas.width, this.canvas.height);
    gl.clearColor(...page, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    gl.enable(gl.POLYGON_OFFSET_FILL); // so that lines on surfaces are seen
    gl.polygonOffset(1, 1);
    if (this.mode !== 4) this.triangles(view, eye, ink, this.mode);
    gl.disable(gl.POLYGON_OFFSET_FILL);
    const { program, uniforms } = this.programs.plain;
    gl.useProgram(program);
    gl.uniformMatrix4fv(uniforms.view, false, view);
    for (const layer of this.layers.values()) {
      if (layer.kind === 'triangles') continue;
      gl.uniform1f(uniforms.size, (layer.size ?? 3) * Math.min(window.devicePixelRatio || 1, 2));
      gl.uniform1i(uniforms.round, layer.kind === 'points');
      gl.bindVertexArray(layer.array);
      gl.drawArrays(layer.kind === 'points' ? gl.POINTS : gl.LINES, 0, layer.count);
    }
    gl.bindVertexArray(null);
  }

  triangles(view, eye, ink, mode) {
    const { gl } = this;
    const { program, uniforms } = this.programs.triangles;
    gl.useProgram(program);
    gl.uniformMatrix4fv(uniforms.view, false, view);
    gl.uniform3fv(uniforms.eye, eye);
    gl.uniform3fv(uniforms.ink, ink);
    gl.uniform1i(uniforms.mode, mode);
    gl.uniform1f(uniforms.shade, this.shade);
    if (this.culled && mode !== 1) { gl.enable(gl.CULL_FACE); gl.cullFace(gl.BACK); }
    for (const layer of this.layers.values()) {
      if (layer.kind !== 'triangles') continue;
      gl.bindVertexArray(layer.array);
      gl.drawArrays(gl.TRIANGLES, 0, layer.count);
    }
    gl.disable(gl.CULL_FACE);
  }

  /** The number of the triangle under a place (0 to 1 from the top left corner), -1 for none. */
  pick(view, eye, x, y) {
    const { gl, canvas } = this;
    const [width, height] = [canvas.width, canvas.height];
    if (!this.target || this.target.width !== width || this.target.height !== height) {
      if (this.target) for (const [what, item] of [['Framebuffer', this.target.frame], ['Renderbuffer', this.target.colour], ['Renderbuffer', this.target.depth]]) gl[`delete${what}`](item);
      const [frame, colour, depth] = [gl.createFramebuffer(), gl.createRenderbuffer(), gl.createRenderbuffer()];
      gl.bindFramebuffer(gl.FRAMEBUFFER, frame);
      for (const [buffer, format, place] of [[colour, gl.RGBA8, gl.COLOR_ATTACHMENT0], [depth, gl.DEPTH_COMPONENT16, gl.DEPTH_ATTACHMENT]]) {
        gl.bindRenderbuffer(gl.RENDERBUFFER, buffer);
        gl.renderbufferStorage(gl.RENDERBUFFER, format, width, height);
        gl.framebufferRenderbuffer(gl.FRAMEBUFFER, place, gl.RENDERBUFFER, buffer);
      }
      this.target = { frame, colour, depth, width, height };
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target.frame);
    gl.viewport(0, 0, width, height);
    gl.clearColor(0, 0, 0, 0);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.enable(gl.DEPTH_TEST);
    gl.disable(gl.BLEND);
    this.triangles(view, eye, [0, 0, 0], 3);
    const pixel = new Uint8Array(4);
    gl.readPixels(Math.floor(x * width), Math.floor((1 - y) * height), 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    return pixel[0] + 256 * pixel[1] + 65536 * pixel[2] - 1;
  }

  close() {
    for (const name of [...this.layers.keys()]) this.remove(name);
    this.gl.getExtension('WEBGL_lose_context')?.loseContext();
  }
}
