// What an operator sees in the headset: the robot's picture before the eyes, and a line of words below it. In view space, so
// it stays where the head looks; the room behind it is the headset's own.
import { FROZEN_MS } from "./pictures.js";

const AWAY_M = 1.4, WIDE_M = 1.7, WORDS_HIGH_M = 0.16, WORDS_PX = [1024, 96], SHOWN_MS = 4000;
const VERTEX = `#version 300 es
in vec2 corner; uniform mat4 to_clip; uniform vec4 box; out vec2 at;
void main() { at = vec2(corner.x, 1.0 - corner.y); gl_Position = to_clip * vec4(box.xy + corner * box.zw, ${-AWAY_M}, 1.0); }`;
const FRAGMENT = `#version 300 es
precision mediump float; in vec2 at; uniform sampler2D picture; uniform float light; out vec4 colour;
void main() { vec4 found = texture(picture, at); colour = vec4(found.rgb * light, found.a); }`;

/** @param {Float32Array} a @param {Float32Array} b @returns {Float32Array} the product a b of 4x4 matrices, by columns */
function product(a, b) {
  const found = new Float32Array(16);
  for (let column = 0; column < 4; column += 1) for (let row = 0; row < 4; row += 1) {
    let sum = 0;
    for (let k = 0; k < 4; k += 1) sum += a[k * 4 + row] * b[column * 4 + k];
    found[column * 4 + row] = sum;
  }
  return found;
}

export class Scene {
  /** @param {WebGL2RenderingContext} gl @param {boolean} is_clear whether the room is seen behind it */
  constructor(gl, is_clear) {
    this.gl = gl;
    this.is_clear = is_clear;
    const program = /** @type {WebGLProgram} */ (gl.createProgram());
    for (const [kind, source] of /** @type {[number, string][]} */ ([[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]])) {
      const shader = /** @type {WebGLShader} */ (gl.createShader(kind));
      gl.shaderSource(shader, source);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    this.program = program;
    const corners = gl.createBuffer();
    gl.bindBuffer(gl.ARRAY_BUFFER, corners);
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array([0, 0, 1, 0, 0, 1, 1, 1]), gl.STATIC_DRAW);
    const corner = gl.getAttribLocation(program, "corner");
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
    this.at = { clip: gl.getUniformLocation(program, "to_clip"), box: gl.getUniformLocation(program, "box"), light: gl.getUniformLocation(program, "light") };
    /** @type {Map<string, {texture: WebGLTexture | null, number: number, ratio: number}>} */
    this.textures = new Map();
    this.page = document.createElement("canvas");
    [this.page.width, this.page.height] = WORDS_PX;
    this.words = "";
    this.words_until = 0;
    this.urgent_until = 0;
    this.words_number = 0;
    this.drawn = 0;
    this.is_frozen = false;
  }

  /**
   * Shows a line for a while. An urgent one stays until the next, and for that while no other takes its place.
   * @param {string} words @param {boolean} is_urgent
   */
  say(words, is_urgent) {
    const now = performance.now();
    if (!is_urgent && now < this.urgent_until) return;
    this.words = words;
    this.words_until = is_urgent ? Infinity : now + SHOWN_MS;
    this.urgent_until = is_urgent ? now + SHOWN_MS : 0;
    const context = /** @type {CanvasRenderingContext2D} */ (this.page.getContext("2d"));
    context.clearRect(0, 0, this.page.width, this.page.height);
    context.fillStyle = is_urgent ? "rgb(165 15 22 / 92%)" : "rgb(12 17 22 / 80%)";
    context.fillRect(0, 0, this.page.width, this.page.height);
    context.fillStyle = "#fff";
    context.font = "600 44px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    context.fillText(words.slice(0, 80), this.page.width / 2, this.page.height / 2, this.page.width - 24);
    this.words_number += 1;
  }

  /** @param {any} layer @param {any} viewer pose of the head, or null @param {import("./pictures.js").Pictures} pictures */
  draw(layer, viewer, pictures) {
    const gl = this.gl;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.clearColor(0.03, 0.05, 0.07, this.is_clear ? 0 : 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    if (!viewer) return;
    gl.useProgram(this.program);
    gl.enable(gl.BLEND);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    const now = performance.now();
    for (const view of viewer.views) {
      const port = layer.getViewport(view);
      if (!port) continue;
      gl.viewport(port.x, port.y, port.width, port.height);
      const to_clip = product(view.projectionMatrix, product(view.transform.inverse.matrix, viewer.transform.matrix));
      gl.uniformMatrix4fv(this.at.clip, false, to_clip);
      const eye = view.eye === "right" ? "right" : "left", picture = pictures.of(eye);
      let below = -0.35;
      if (picture) {
        const made = this.texture(eye, picture.bitmap, picture.number), high = WIDE_M / made.ratio;
        below = -high / 2;
        this.is_frozen = now - picture.at > FROZEN_MS;
        this.box(-WIDE_M / 2, below, WIDE_M, high, this.is_frozen ? 0.35 : 1);
      }
      if (this.words && now < this.words_until) {
        this.texture("words", this.page, this.words_number);
        const wide = WORDS_HIGH_M * WORDS_PX[0] / WORDS_PX[1];
        this.box(-wide / 2, below - WORDS_HIGH_M * 1.2, wide, WORDS_HIGH_M, 1);
      }
    }
    this.drawn += 1;
  }

  /** @param {number} x @param {number} y @param {number} wide @param {number} high [m] @param {number} light */
  box(x, y, wide, high, light) {
    this.gl.uniform4f(this.at.box, x, y, wide, high);
    this.gl.uniform1f(this.at.light, light);
    this.gl.drawArrays(this.gl.TRIANGLE_STRIP, 0, 4);
  }

  /** Binds a texture, filled anew where its picture is another. @param {string} name @param {any} source @param {number} number */
  texture(name, source, number) {
    const gl = this.gl;
    const found = this.textures.get(name) ?? { texture: gl.createTexture(), number: -1, ratio: 1 };
    this.textures.set(name, found);
    gl.bindTexture(gl.TEXTURE_2D, found.texture);
    if (found.number !== number) {
      found.number = number;
      found.ratio = source.width / source.height;
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, source);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
      gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
    }
    return found;
  }
}
