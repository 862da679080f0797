// The raster's picture, drawn by the graphics card: aside, then copied to the page's 2D canvas, so
// that the raster can go on there where the card is lost.
import { Raster } from "viewer/raster.js";

const SOFTWARE = /swiftshader|llvmpipe|softpipe|basic render|gdi generic|software/i;
const NEAREST = 0.001; // of the way to what is looked at: nothing nearer is drawn

// null where the browser draws in software or not at all; `wish` "gl" or "canvas" forces one.
export function openGl(canvas, wish, whenLost) {
  const isForced = wish === "gl", options = { alpha: false, antialias: false, failIfMajorPerformanceCaveat: !isForced };
  const gl = wish === "canvas" ? null : document.createElement("canvas").getContext("webgl2", options);
  const told = gl?.getExtension("WEBGL_debug_renderer_info")?.UNMASKED_RENDERER_WEBGL ?? gl?.RENDERER;
  if (!gl || (!isForced && SOFTWARE.test(gl.getParameter(told)))) return null;
  gl.canvas.addEventListener("webglcontextlost", whenLost);
  try { return new GlRaster(canvas, gl); } catch (error) { console.warn(error); return null; }
}

const POINT = [`
  layout(location = 0) in vec3 at;
  layout(location = 1) in vec4 color;
  uniform vec4 right, up, forward, clip;
  uniform vec2 size;
  uniform float focal, near, side;
  flat out vec4 shade;
  void main() {
    float depth = dot(forward, vec4(at, 1));
    bool isHidden = color.a == 0.0 || depth < 1e-4 || dot(clip.xyz, at) > clip.w;
    vec2 seen = vec2(dot(right, vec4(at, 1)), -dot(up, vec4(at, 1))) * focal / depth;
    vec2 middle = floor(size / 2.0 - floor(side / 2.0) + seen) + side / 2.0;
    gl_Position = isHidden ? vec4(2, 2, 2, 1) : vec4((2.0 * middle / size - 1.0) * vec2(1, -1), 1.0 - 2.0 * near / depth, 1);
    gl_PointSize = side;
    shade = color;
  }`, `
  flat in vec4 shade;
  out vec4 pixel;
  void main() { pixel = vec4(shade.rgb, 1); }`];

// A rod or a ball in a quad with room to spare; what of it counts says each pixel, as in the raster.
const SHAPE = [`
  layout(location = 2) in vec4 a;
  layout(location = 3) in vec4 b;
  layout(location = 4) in vec3 paint;
  uniform vec2 size;
  flat out vec4 from, to;
  flat out vec3 kind;
  void main() {
    vec2 corner = vec2(gl_VertexID & 1, gl_VertexID >> 1), way = b.xy - a.xy;
    vec2 along = (max(a.w, b.w) + 2.0) * (length(way) > 0.0 ? normalize(way) : vec2(1, 0));
    vec2 at = mix(a.xy, b.xy, corner.x) + mat2(along, -along.y, along.x) * (2.0 * corner - 1.0);
    gl_Position = vec4((2.0 * at / size - 1.0) * vec2(1, -1), 0, 1);
    from = a; to = b; kind = paint;
  }`, `
  flat in vec4 from, to;
  flat in vec3 kind; // colour, is it solid, is it a ball
  uniform vec2 size;
  uniform float focal, near;
  out vec4 pixel;
  void main() {
    vec2 at = vec2(floor(gl_FragCoord.x), size.y - 1.0 - floor(gl_FragCoord.y)), way = to.xy - from.xy;
    vec4 place = from;
    float off = distance(at + 0.5, from.xy) / from.w;
    if (kind.z == 0.0) {
      bool isTall = abs(way.x) < abs(way.y);
      if (isTall) { at = at.yx; way = way.yx; }
      vec2 ends = isTall ? vec2(from.y, to.y) : vec2(from.x, to.x);
      if (at.x < floor(min(ends.x, ends.y)) || at.x > ceil(max(ends.x, ends.y))) discard;
      bool isLong = abs(way.x) > 1e-6;
      if (isLong) place = mix(from, to, clamp((at.x - ends.x) / way.x, 0.0, 1.0));
      float middle = isTall ? place.x : place.y, half_ = place.w * (isLong ? length(way) / abs(way.x) : 1.0);
      if (at.y < floor(middle - half_ + 0.5) || at.y > floor(middle + half_ - 0.5)) discard;
      off = min(abs(at.y + 0.5 - middle) / half_, 1.0);
    } else if (off > 1.0) discard;
    float bulge = sqrt(1.0 - off * off), surface = place.z / max(1.0 - place.w / focal * bulge, 0.1);
    vec3 color = vec3((uvec3(kind.x) >> uvec3(0, 8, 16)) & 255u);
    pixel = vec4(floor(color * (kind.y > 0.0 ? 0.5 + 0.5 * bulge : 1.0)) / 255.0, 1);
    gl_FragDepth = kind.y > 0.0 ? 1.0 - near * surface : 0.0;
  }`];

class GlRaster extends Raster {
  constructor(canvas, gl) {
    super(canvas);
    Object.assign(this, { gl, held: new Map(), shapes: [] }); // shapes: of one picture, 11 numbers each
    this.point = programOf(gl, POINT);
    this.shape = programOf(gl, SHAPE);
    [this.places, this.paints, this.records] = [0, 0, 0].map(() => gl.createBuffer());
    const attributes = [[this.places, 3], [this.paints, 4], [this.records, 4], [this.records, 4], [this.records, 3]];
    attributes.forEach(([buffer, size], i) => {
      const isPaint = buffer === this.paints, isRecord = buffer === this.records;
      gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
      gl.enableVertexAttribArray(i);
      gl.vertexAttribPointer(i, size, isPaint ? gl.UNSIGNED_BYTE : gl.FLOAT, isPaint, isRecord ? 44 : 0, isRecord ? 16 * (i - 2) : 0);
      gl.vertexAttribDivisor(i, isRecord ? 1 : 0);
    });
    gl.enable(gl.DEPTH_TEST);
  }

  resize(width, height) {
    for (const canvas of [this.canvas, this.gl.canvas]) Object.assign(canvas, { width, height });
    Object.assign(this, { width, height });
    this.gl.viewport(0, 0, width, height);
  }

  clear(color, distance) {
    const { gl } = this;
    this.near = NEAREST * distance;
    gl.clearColor(...[0, 8, 16].map((bits) => ((color >> bits) & 255) / 255), 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  }

  points(positions, colors, m, focal, size, clip) {
    const { gl } = this, side = [Math.max(Math.round(size * this.ratio), 1)];
    this.fill(this.places, positions);
    this.fill(this.paints, colors);
    this.use(this.point, { right: m.slice(0, 4), up: m.slice(4, 8), forward: m.slice(8), clip: clip || [0, 0, 0, 1], side, focal: [focal] });
    gl.depthFunc(gl.LESS);
    gl.drawArrays(gl.POINTS, 0, colors.length);
  }

  rod(from, to, color, solid, focal) { this.add(from, to, color, solid, focal, 0); }

  ball(place, color, solid, focal) { this.add(place, place, color, solid, focal, 1); }

  add(from, to, color, solid, focal, isBall) {
    this.focal = focal;
    this.shapes.push(...from, ...to, color & 0xffffff, Number(solid), isBall);
  }

  show() {
    const { gl, shapes } = this;
    this.fill(this.records, new Float32Array(shapes));
    this.use(this.shape, { focal: [this.focal] });
    gl.depthFunc(gl.LEQUAL); // in their order, what is not solid lies over all before it
    gl.drawArraysInstanced(gl.TRIANGLE_STRIP, 0, 4, shapes.length / 11);
    this.shapes = [];
    this.context.drawImage(gl.canvas, 0, 0);
  }

  // An array goes to the card once.
  fill(buffer, array) {
    const { gl, held } = this;
    if (held.get(buffer) === array) return;
    held.set(buffer, array);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffer);
    gl.bufferData(gl.ARRAY_BUFFER, array, gl.STATIC_DRAW);
  }

  use(program, uniforms) {
    const { gl } = this, all = { ...uniforms, size: [this.width, this.height], near: [this.near] };
    gl.useProgram(program);
    for (const [name, value] of Object.entries(all)) gl[`uniform${value.length}fv`](gl.getUniformLocation(program, name), value);
  }
}

function programOf(gl, sources) {
  const program = gl.createProgram();
  sources.forEach((source, i) => {
    const shader = gl.createShader(i ? gl.FRAGMENT_SHADER : gl.VERTEX_SHADER);
    gl.shaderSource(shader, `#version 300 es\nprecision highp float;\n${source}`);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  });
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}
