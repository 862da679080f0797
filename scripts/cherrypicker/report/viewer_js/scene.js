// The scene: what is shown of clouds and skeletons, from where, and in which colours.
import { OrbitCamera, readHash } from "viewer/camera.js";
import { Colors, pack, packAll } from "viewer/colors.js";
import { place } from "viewer/data.js";
import { openGl } from "viewer/gl.js";
import { Raster } from "viewer/raster.js";

const THIN = 1.3, PICKED = 2.6; // half widths, px
const PICKED_COLOR = [255, 0, 170], OFF_COLOR = [150, 150, 150], NEW_COLOR = [255, 140, 0];
const CAMERA_COLOR = [208, 32, 32];
const FRUSTUM = 0.07; // of the scene's reach
const FLIGHT_MS = 350;
//: What an edit made of a node
export const SOUND = 0, OFF = 1, GONE = 2, NEW = 3;

export class Scene {
  constructor(canvas, data) {
    this.canvas = canvas;
    this.data = data;
    this.wish = readHash(location.hash).draw; // how the address wants it drawn
    this.raster = openGl(canvas, this.wish, () => { this.useCanvas(); this.recolor(); });
    if (!this.raster) this.useCanvas();
    this.camera = new OrbitCamera(data.home);
    this.colors = new Colors(data);
    this.show = { cloud: true, skeleton: true, thick: false, cameras: false };
    this.size = 2;
    this.hidden = new Set(); // classes
    this.clip = null; // [nx, ny, nz, limit]
    this.picked = null; // the number of a branch
    this.lit = null; // 1 for each node that an edit is about to move
    this.marks = []; // {at: [x, y, z], color}, and {from, to, color}
    this.schemes = { points: data.cloud.hasColor ? "photo" : "class", skeleton: "order" };
    this.afterDraw = [];
    const { n } = data.skeleton;
    this.layer = { state: new Uint8Array(n), screen: new Float32Array(4 * n) }; // of its nodes
    this.recolor();
    window.addEventListener("resize", () => this.redraw());
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.redraw());
  }

  // The first points of the cloud are as many as it draws in time.
  useCanvas() {
    this.raster = new Raster(this.canvas);
    this.data.cloud.n = this.data.cloud.first;
  }

  recolor() {
    const { data, colors, schemes, layer } = this, { cloud, skeleton } = data;
    this.pointScheme = colors.points[schemes.points].of();
    this.pointColors = packAll(cloud.n, this.pointScheme.color);
    const isOut = (i) => cloud.removed?.[i] && schemes.points !== "removed";
    for (let i = 0; i < cloud.n; i++) if (isOut(i) || this.hidden.has(cloud.label[i])) this.pointColors[i] = 0;
    layer.scheme = colors.nodes[schemes.skeleton].of(skeleton);
    layer.colors = packAll(skeleton.n, layer.scheme.color);
    this.redraw();
  }

  redraw() {
    if (this.waiting) return;
    this.waiting = true;
    requestAnimationFrame(() => { this.waiting = false; this.draw(); });
  }

  draw() {
    const { raster, camera, data } = this;
    raster.fit();
    this.matrix = camera.matrix();
    this.focal = camera.focal(raster.height);
    raster.clear(this.background(), camera.distance);
    if (this.show.cloud) {
      raster.points(data.cloud.positions, this.pointColors, this.matrix, this.focal, this.size, this.clip);
    }
    this.projectNodes();
    if (this.show.skeleton) this.drawSkeleton();
    if (this.show.cameras) for (const item of data.cameras) this.drawFrustum(item);
    for (const mark of this.marks) this.drawMark(mark);
    raster.show();
    for (const call of this.afterDraw) call();
  }

  background() {
    const found = getComputedStyle(this.canvas).backgroundColor.match(/\d+/g);
    return pack((found || [250, 250, 247]).slice(0, 3).map(Number));
  }

  // [u, v, 1 / depth, px a unit] in px of the raster; depth <= 0 gives 0.
  project(at) {
    const m = this.matrix, { width, height } = this.raster;
    const depth = m[8] * at[0] + m[9] * at[1] + m[10] * at[2] + m[11];
    if (depth < 1e-4) return [0, 0, 0, 0];
    const scale = this.focal / depth;
    const x = m[0] * at[0] + m[1] * at[1] + m[2] * at[2] + m[3];
    const y = m[4] * at[0] + m[5] * at[1] + m[6] * at[2] + m[7];
    return [width / 2 + x * scale, height / 2 - y * scale, 1 / depth, scale];
  }

  projectNodes() {
    const { skeleton } = this.data, { screen } = this.layer;
    for (let node = 0; node < skeleton.n; node++) {
      const at = place(skeleton.points, node);
      screen.set(this.isClipped(at) ? [0, 0, 0, 0] : this.project(at), 4 * node);
    }
  }

  isClipped([x, y, z]) {
    return this.clip !== null && this.clip[0] * x + this.clip[1] * y + this.clip[2] * z > this.clip[3];
  }

  drawSkeleton() {
    const { skeleton } = this.data, { state, screen, colors } = this.layer;
    const { raster, focal, picked } = this, solid = this.show.thick;
    const off = pack(OFF_COLOR), fresh = pack(NEW_COLOR), chosen = pack(PICKED_COLOR);
    for (let node = 1; node < skeleton.n; node++) {
      const parent = skeleton.parent[node], from = 4 * parent, to = 4 * node;
      if (parent < 0 || state[node] === GONE || !screen[from + 2] || !screen[to + 2]) continue;
      const isPicked = skeleton.axis[node] === picked || this.lit?.[node];
      const color = state[node] === OFF ? off : isPicked ? chosen : state[node] === NEW ? fresh : colors[node];
      // A junction's radius is the thicker axis's
      const own = skeleton.axis[parent] === skeleton.axis[node] ? skeleton.radius[parent] : skeleton.radius[node];
      const least = (isPicked || state[node] === NEW ? PICKED : solid ? 0.7 : THIN) * raster.ratio;
      const half = (radius, at) => (solid ? Math.max(radius * screen[at + 3], least) : least);
      const a = [screen[from], screen[from + 1], screen[from + 2], half(own, from)];
      const b = [screen[to], screen[to + 1], screen[to + 2], half(skeleton.radius[node], to)];
      raster.rod(a, b, color, solid, focal);
      if (solid) raster.ball(b, color, true, focal);
    }
  }

  drawLine(from, to, color, half = THIN) {
    const a = this.project(from), b = this.project(to);
    if (!a[2] || !b[2]) return;
    const width = half * this.raster.ratio;
    this.raster.rod([a[0], a[1], a[2], width], [b[0], b[1], b[2], width], color, false, this.focal);
  }

  drawFrustum(camera) {
    const color = pack(camera.picked ? PICKED_COLOR : CAMERA_COLOR), reach = FRUSTUM * this.data.home.reach;
    const corners = camera.rays.map((ray) => camera.center.map((c, i) => c + reach * ray[i]));
    corners.forEach((corner, i) => {
      this.drawLine(camera.center, corner, color, 0.7);
      this.drawLine(corner, corners[(i + 1) % 4], color, 0.7);
    });
  }

  drawMark(mark) {
    const color = pack(mark.color || PICKED_COLOR);
    if (mark.from) return this.drawLine(mark.from, mark.to, color);
    const at = this.project(mark.at);
    if (at[2]) this.raster.ball([at[0], at[1], at[2], 5 * this.raster.ratio], color, false, this.focal);
  }

  // Where a place lies on the canvas, CSS px; null behind the eye.
  onCanvas(at) {
    const [u, v, inverse] = this.project(at);
    return inverse ? [u / this.raster.ratio, v / this.raster.ratio] : null;
  }

  // Move the eye to look at places; at once where the reader wants no motion.
  flyTo(places) {
    const { camera, data } = this;
    const low = [0, 1, 2].map((k) => Math.min(...places.map((p) => p[k])));
    const high = [0, 1, 2].map((k) => Math.max(...places.map((p) => p[k])));
    const reach = Math.max(Math.hypot(...high.map((v, k) => v - low[k])) / 2, 0.08 * data.home.reach);
    const goal = [camera.azimuth, camera.elevation, 3.2 * reach, ...low.map((v, k) => (v + high[k]) / 2)];
    const start = camera.state(), began = performance.now();
    if (matchMedia("(prefers-reduced-motion: reduce)").matches) return this.moveTo(goal);
    const flight = (this.flight = () => {
      if (this.flight !== flight) return; // another one has begun
      const t = Math.min((performance.now() - began) / FLIGHT_MS, 1), share = t * t * (3 - 2 * t);
      this.moveTo(start.map((value, i) => value + share * (goal[i] - value)));
      if (t < 1) requestAnimationFrame(flight);
    });
    flight();
  }

  moveTo(numbers) {
    this.camera.set(numbers);
    this.redraw();
  }
}
