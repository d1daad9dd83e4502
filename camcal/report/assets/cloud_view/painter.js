// The points on the graphics card.

const VERTEX = `
attribute vec3 place;
attribute vec3 colour;
uniform mat4 matrix;
uniform vec3 camera;   // where the camera stood, if the points stand farther apart the farther they are from it
uniform float grows;   // 1 if so
uniform float spacing;
uniform float pixels;
uniform float least;
varying vec3 shade;
varying float size;
void main() {
  gl_Position = matrix * vec4(place, 1.0);
  float apart = spacing * mix(1.0, distance(place, camera), grows);
  size = clamp(apart * pixels / gl_Position.w, least, 64.0);
  gl_PointSize = size;
  shade = colour;
}`;

const FRAGMENT = `
precision mediump float;
varying vec3 shade;
varying float size;
void main() {
  vec2 from = gl_PointCoord - 0.5;
  if (size > 3.0 && dot(from, from) > 0.25) discard;
  gl_FragColor = vec4(shade, 1.0);
}`;

const OVERLAP = 1.6; // diameter of a point in spacings at which surfaces look closed

class Painter {
  constructor(canvas, cloud) {
    const gl = canvas.getContext("webgl", { antialias: false, alpha: false });
    if (!gl) throw new Error("This browser shows no WebGL.");
    Object.assign(this, { canvas, cloud, gl });
    this.program = this.#program();
    gl.useProgram(this.program);
    gl.enable(gl.DEPTH_TEST);
    this.#attribute("place", cloud.places, gl.FLOAT, false);
    this.colourBuffer = this.#attribute("colour", new Uint8Array(3 * cloud.count), gl.UNSIGNED_BYTE, true);
    gl.uniform3fv(this.#uniform("camera"), scaled(cloud.middle, -1));
    gl.uniform1f(this.#uniform("grows"), cloud.facts.spacing_grows ? 1 : 0);
  }

  #program() {
    const { gl } = this;
    const program = gl.createProgram();
    for (const [kind, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
    return program;
  }

  #attribute(name, values, type, normalised) {
    const { gl } = this;
    const buffer = gl.createBuffer();
    const place = gl.getAttribLocation(this.program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, 3, type, normalised, 0, 0);
    return buffer;
  }

  #uniform(name) {
    return this.gl.getUniformLocation(this.program, name);
  }

  colour(values) {
    const { gl } = this;
    gl.bindBuffer(gl.ARRAY_BUFFER, this.colourBuffer);
    gl.bufferData(gl.ARRAY_BUFFER, values, gl.STATIC_DRAW);
  }

  draw(viewpoint, pointSize, paper) {
    const { gl, canvas, cloud } = this;
    const ratio = canvas.width / viewpoint.size[0];
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(...paper, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.uniformMatrix4fv(this.#uniform("matrix"), false, viewpoint.matrix(cloud.middle));
    gl.uniform1f(this.#uniform("spacing"), OVERLAP * pointSize * cloud.facts.spacing);
    gl.uniform1f(this.#uniform("pixels"), ratio * viewpoint.pixels);
    gl.uniform1f(this.#uniform("least"), Math.max(1, ratio * Math.min(pointSize, 1)));
    gl.drawArrays(gl.POINTS, 0, cloud.count);
  }
}
