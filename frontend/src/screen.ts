// Draws frames with WebGL2, in two steps. When a frame comes, its codec is undone and its channels
// are mixed to linear colours (a float16 texture). When something is shown, that texture is moved
// and zoomed into place and toned. So exposure, stretch and colours need no new frame.

import { inflate, limitsOf, undifference } from "./half";
import type { Tone } from "./tone";
import type { FrameHead } from "./wire";

/** Scale and shift of a picture, in clip coordinates (-1 to 1 across the canvas). */
export interface Place {
  scale: [number, number];
  shift: [number, number];
}

export interface Picture {
  head: FrameHead;
  /** Smallest, smallest positive and largest number of each channel, of an exact frame. */
  limits?: [number, number, number][];
  bitmap?: ImageBitmap;
  halves?: Uint16Array;
}

export interface Drawn {
  tone: Tone;
  place: Place;
}

/** Undo the codec, as far as that happens outside of the shader. */
export async function decode(head: FrameHead, bytes: Uint8Array): Promise<Picture> {
  if (head.codec === "float16") {
    const halves = undifference(await inflate(bytes), head.width, head.height, head.channels);
    const size = head.width * head.height;
    const limits = Array.from({ length: head.channels }, (_, c) => {
      return limitsOf(halves.subarray(c * size, (c + 1) * size)).map((v) => v * 2 ** head.low);
    });
    return { head, halves, limits: limits as [number, number, number][] };
  }
  // The numbers are logarithms, not colours: no profile may be applied to them.
  const options: ImageBitmapOptions = { colorSpaceConversion: "none", premultiplyAlpha: "none" };
  return { head, limits: head.limits, bitmap: await createImageBitmap(new Blob([bytes as BlobPart], { type: "image/jpeg" }), options) };
}

// Half floats reach from 2^-14 to 2^15: the brightest is put near the top, 26 stops below it fit.
const TOP = 12;
const MOST_CHANNELS = 16;

const VERTEX = `#version 300 es
uniform vec4 place;
out vec2 at;
void main() {
  vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1);
  at = vec2(corner.x, 1.0 - corner.y);
  gl_Position = vec4((corner * 2.0 - 1.0) * place.xy + place.zw, 0, 1);
}`;

// Variants are compiled apart, by numbers that are put in front: a renderer without a graphics card
// computes every branch, and logarithms are most of the work.
const MIX = `
precision highp float;
precision highp sampler2DArray;
uniform sampler2D picture;
uniform sampler2DArray planes;
uniform int channels, rows;
uniform float low, step_, scale;
uniform vec3 mix_[${MOST_CHANNELS}];
out vec4 color;
float bright(float v) {
  float code = round(v * 255.0);
#if LINEAR
  return code < 0.5 ? -65000.0 : low + step_ * (code - 1.0);
#else
  return code < 0.5 ? 0.0 : exp2(low + step_ * (code - 1.0));
#endif
}
void main() {
  ivec2 at = ivec2(gl_FragCoord.xy);
  vec3 sum = vec3(0);
  for (int c = 0; c < channels; c++) {
#if CODEC == 0
    float v = bright(texelFetch(picture, at, 0)[c]);
#elif CODEC == 1
    float v = bright(texelFetch(picture, at + ivec2(0, c * rows), 0).r);
#else
    float v = texelFetch(planes, ivec3(at, c), 0).r * scale;
#endif
    sum += mix_[c] * v;
  }
  color = vec4(clamp(sum, -65000.0, 65000.0), 1);
}`;

const TONE = `
precision highp float;
uniform sampler2D linear_, table;
uniform float black, white, gamma, softening, fade;
in vec2 at;
out vec4 color;
float asinh_(float v) { return log(v + sqrt(v * v + 1.0)); }
float bend(float v) {
#if CURVE == 1
  return asinh_(v / softening) / asinh_(1.0 / softening);
#elif CURVE == 2
  return log(1.0 + v / softening) / log(1.0 + 1.0 / softening);
#elif CURVE == 3
  return pow(v, 1.0 / gamma);
#else
  return v;
#endif
}
void main() {
  vec3 v = texture(linear_, at).rgb;
#if MODE >= 2
#if MODE == 3
  float p = log(max(v.r, black) / black) / log(white / black);
#else
  float p = bend(clamp((v.r - black) / (white - black), 0.0, 1.0));
#endif
  vec3 shown = v.r < -64000.0 ? vec3(0) : texelFetch(table, ivec2(clamp(int(p * 256.0), 0, 255), 0), 0).rgb;
#else
  vec3 lit = max((v - black) / (white - black), 0.0);
#if MODE == 1
  float most = max(max(lit.r, max(lit.g, lit.b)), 1e-30);
  vec3 shown = min(lit * (bend(min(most, 1.0)) / most), 1.0);
#else
  vec3 shown = vec3(bend(min(lit.r, 1.0)), bend(min(lit.g, 1.0)), bend(min(lit.b, 1.0)));
#endif
#endif
  color = vec4(shown, fade);
}`;

interface Program {
  use: WebGLProgram;
  uniforms: [WebGLUniformLocation, name: string, type: number][];
}

function program(gl: WebGL2RenderingContext, variant: string, fragment: string): Program {
  const use = gl.createProgram()!;
  for (const [type, source] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, `#version 300 es\n${variant}${fragment}`]] as const) {
    const shader = gl.createShader(type)!;
    gl.shaderSource(shader, source);
    gl.compileShader(shader);
    gl.attachShader(use, shader);
  }
  gl.linkProgram(use);
  if (gl.isContextLost()) return { use, uniforms: [] };
  if (!gl.getProgramParameter(use, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(use) ?? "the shader does not link");
  const count: number = gl.getProgramParameter(use, gl.ACTIVE_UNIFORMS);
  const uniforms = [...Array(count).keys()].map((i) => {
    const { name, type } = gl.getActiveUniform(use, i)!;
    return [gl.getUniformLocation(use, name)!, name.replace("[0]", ""), type] as Program["uniforms"][number];
  });
  return { use, uniforms };
}

/** A frame as it lies on the graphics card. */
interface Layer {
  picture: Picture;
  source: WebGLTexture;
  linear: WebGLTexture;
  mixed: string;
}

export interface Surface {
  /** Take a frame; the one before it stays below while the new one fades in. */
  take(picture: Picture): void;
  draw(now: Drawn, before: Drawn | null, fade: number): void;
  setTable(name: string, table: Uint8Array): void;
}

export class Screen implements Surface {
  private programs = new Map<string, Program>();
  private target!: WebGLFramebuffer;
  private table!: WebGLTexture;
  private tableName = "";
  private layers: Layer[] = [];

  /** Return a screen, or null where there is no WebGL2 that draws into float textures. */
  static on(canvas: HTMLCanvasElement, restored: () => void): Screen | null {
    const gl = canvas.getContext("webgl2", { alpha: false, antialias: false, preserveDrawingBuffer: true });
    if (!gl || !(gl.getExtension("EXT_color_buffer_float") || gl.getExtension("EXT_color_buffer_half_float"))) {
      return null;
    }
    const screen = new Screen(gl);
    canvas.addEventListener("webglcontextlost", (event) => event.preventDefault());
    canvas.addEventListener("webglcontextrestored", () => {
      gl.getExtension("EXT_color_buffer_float");
      screen.start();
      restored();
    });
    return screen;
  }

  private constructor(private gl: WebGL2RenderingContext) {
    this.start();
  }

  private start(): void {
    const { gl } = this;
    const last = this.layers.at(-1)?.picture;
    this.layers = [];
    this.tableName = "";
    this.programs.clear();
    this.target = gl.createFramebuffer()!;
    this.table = gl.createTexture()!;
    gl.pixelStorei(gl.UNPACK_COLORSPACE_CONVERSION_WEBGL, gl.NONE);
    gl.pixelStorei(gl.UNPACK_ALIGNMENT, 1);
    if (last) this.take(last);
  }

  /** Draw a rectangle with a variant of a shader; uniforms by name, textures in the order of their units. */
  private paint(variant: string, source: string, textures: [number, WebGLTexture | null][], values: Record<string, number | number[]>): void {
    const { gl } = this;
    const made = this.programs.get(variant) ?? program(gl, variant, source);
    this.programs.set(variant, made);
    gl.useProgram(made.use);
    for (const [location, name, type] of made.uniforms) {
      const value = [values[name]].flat();
      if (type === gl.FLOAT_VEC3) gl.uniform3fv(location, value);
      else if (type === gl.FLOAT_VEC4) gl.uniform4fv(location, value);
      else if (type === gl.FLOAT) gl.uniform1f(location, value[0]);
      else gl.uniform1i(location, value[0]);
    }
    textures.forEach(([target, texture], unit) => {
      gl.activeTexture(gl.TEXTURE0 + unit);
      gl.bindTexture(target, texture);
    });
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
    gl.activeTexture(gl.TEXTURE0);
  }

  take(picture: Picture): void {
    const { gl } = this;
    if (gl.isContextLost()) {
      if (this.layers.length) this.layers[this.layers.length - 1].picture = picture;
      return;
    }
    const source = gl.createTexture()!;
    const { width, height, channels } = picture.head;
    if (picture.bitmap) {
      gl.bindTexture(gl.TEXTURE_2D, source);
      filter(gl, gl.TEXTURE_2D, gl.NEAREST);
      gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA8, gl.RGBA, gl.UNSIGNED_BYTE, picture.bitmap);
    } else {
      gl.bindTexture(gl.TEXTURE_2D_ARRAY, source);
      filter(gl, gl.TEXTURE_2D_ARRAY, gl.NEAREST);
      gl.texImage3D(
        gl.TEXTURE_2D_ARRAY, 0, gl.R16F, width, height, channels, 0, gl.RED, gl.HALF_FLOAT, picture.halves!,
      );
    }
    const linear = gl.createTexture()!;
    gl.bindTexture(gl.TEXTURE_2D, linear);
    filter(gl, gl.TEXTURE_2D, gl.LINEAR);
    gl.texStorage2D(gl.TEXTURE_2D, 1, gl.RGBA16F, width, height);
    this.layers.push({ picture, source, linear, mixed: "" });
    while (this.layers.length > 2) this.drop(this.layers.shift()!);
  }

  private drop(layer: Layer): void {
    this.gl.deleteTexture(layer.source);
    this.gl.deleteTexture(layer.linear);
    layer.picture.bitmap?.close();
  }

  setTable(name: string, table: Uint8Array): void {
    if (name === this.tableName) return;
    const { gl } = this;
    this.tableName = name;
    gl.bindTexture(gl.TEXTURE_2D, this.table);
    filter(gl, gl.TEXTURE_2D, gl.NEAREST);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB8, 256, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, table);
  }

  draw(now: Drawn, before: Drawn | null, fade: number): void {
    const { gl } = this;
    if (gl.isContextLost() || !this.layers.length) return;
    const shown = this.layers.slice(fade < 1 && before ? -2 : -1);
    const how = shown.length === 2 ? [before!, now] : [now];
    shown.forEach((layer, i) => this.mixChannels(layer, how[i].tone));
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.clearColor(0, 0, 0, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
    shown.forEach((layer, i) => this.showLayer(layer, how[i], shown.length === 2 && i === 1 ? fade : 1));
  }

  private showLayer(layer: Layer, { tone, place }: Drawn, fade: number): void {
    const { gl } = this;
    const curve = tone.curve === "power" && tone.gamma !== 1 ? 3 : ["power", "asinh", "log"].indexOf(tone.curve);
    const mode = tone.colormap !== null ? (tone.logarithmic ? 3 : 2) : tone.hue ? 1 : 0;
    if (fade < 1) gl.enable(gl.BLEND);
    else gl.disable(gl.BLEND);
    const { head } = layer.picture;
    const scale = 2 ** (TOP - topOf(head));
    // Pixel on pixel nothing is interpolated, which is dear without a graphics card.
    const isWhole = head.width === gl.drawingBufferWidth && head.height === gl.drawingBufferHeight && [...place.scale.map((v) => v - 1), ...place.shift].every((off) => Math.abs(off) < 1e-6);
    gl.bindTexture(gl.TEXTURE_2D, layer.linear);
    filter(gl, gl.TEXTURE_2D, isWhole ? gl.NEAREST : gl.LINEAR);
    this.paint(`#define CURVE ${curve}\n#define MODE ${mode}\n`, TONE, [[gl.TEXTURE_2D, layer.linear], [gl.TEXTURE_2D, this.table]], {
      linear_: 0, table: 1, place: [...place.scale, ...place.shift], fade,
      black: tone.black * scale, white: tone.white * scale, gamma: tone.gamma, softening: tone.softening,
    });
  }

  private mixChannels(layer: Layer, tone: Tone): void {
    const key = JSON.stringify(tone.mix);
    if (layer.mixed === key) return;
    layer.mixed = key;
    const { gl } = this;
    const { width, height, channels, low, high } = layer.picture.head;
    gl.bindFramebuffer(gl.FRAMEBUFFER, this.target);
    gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0, gl.TEXTURE_2D, layer.linear, 0);
    gl.viewport(0, 0, width, height);
    gl.disable(gl.BLEND);
    const codec = layer.picture.halves ? 2 : channels === 3 ? 0 : 1;
    const shift = TOP - topOf(layer.picture.head);
    const linear = layer.picture.head.codec === "linear-jpeg";
    const unit = linear ? 2 ** shift : 1;
    // A texture that is drawn into may not be bound, not even unused.
    const picture = codec === 2 ? this.table : layer.source;
    const planes = codec === 2 ? layer.source : null;
    this.paint(`#define CODEC ${codec}\n#define LINEAR ${Number(linear)}\n`, MIX, [[gl.TEXTURE_2D, picture], [gl.TEXTURE_2D_ARRAY, planes]], {
      picture: 0, planes: 1, place: [1, 1, 0, 0], channels: Math.min(channels, MOST_CHANNELS), rows: height,
      low: linear ? low * unit : low + shift, step_: ((high - low) / 254) * unit, scale: 2 ** (low + shift), mix_: tone.mix.slice(0, MOST_CHANNELS).flat(),
    });
  }
}

/** log2 of the largest number that a frame may hold. */
function topOf(head: FrameHead): number {
  if (head.codec === "linear-jpeg") return Math.ceil(Math.log2(Math.max(Math.abs(head.low), Math.abs(head.high)) || 1));
  return Math.ceil(head.high ?? head.low + 15);
}

function filter(gl: WebGL2RenderingContext, target: number, how: number): void {
  gl.texParameteri(target, gl.TEXTURE_MIN_FILTER, how);
  gl.texParameteri(target, gl.TEXTURE_MAG_FILTER, how);
  gl.texParameteri(target, gl.TEXTURE_WRAP_S, gl.CLAMP_TO_EDGE);
  gl.texParameteri(target, gl.TEXTURE_WRAP_T, gl.CLAMP_TO_EDGE);
}
