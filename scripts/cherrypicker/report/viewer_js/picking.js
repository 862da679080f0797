// What lies below a pixel: a node of a skeleton, a point of the cloud, a camera.
import { place } from "viewer/data.js";
import { GONE } from "viewer/scene.js";

const NEAR_PX = 7, NEAR_POINT_PX = 4, NEAR_CAMERA_PX = 12;

// The nearest wood: {node, nearest, at}; `nearest` is the node there, `node` the nearest
// of the branch that is meant, which at a junction is another. Drawn lines come first, for they are
// drawn over the cloud; then the foremost point of the wood.
export function pickWood(scene, x, y) {
  const u = x * scene.raster.ratio, v = y * scene.raster.ratio;
  return (scene.show.skeleton && pickLine(scene, u, v)) || (scene.show.cloud && pickPoint(scene, u, v, true)) || null;
}

function pickLine(scene, u, v) {
  const solid = scene.show.thick, near = NEAR_PX * scene.raster.ratio;
  let best = null, least = Infinity;
  const { skeleton } = scene.data, { state, screen } = scene.layer;
  for (let node = 1; node < skeleton.n; node++) {
    const parent = skeleton.parent[node], a = 4 * parent, b = 4 * node;
    if (parent < 0 || state[node] === GONE || !screen[a + 2] || !screen[b + 2]) continue;
    const dx = screen[b] - screen[a], dy = screen[b + 1] - screen[a + 1];
    const length = dx * dx + dy * dy;
    const along = length ? ((u - screen[a]) * dx + (v - screen[a + 1]) * dy) / length : 0;
    const t = Math.min(Math.max(along, 0), 1);
    const off = Math.hypot(u - screen[a] - t * dx, v - screen[a + 1] - t * dy);
    const reach = solid ? Math.max(near / 2, skeleton.radius[node] * screen[b + 3]) : near;
    // Tubes hide what is behind them, lines do not
    const rank = solid ? 1 / screen[b + 2] : off;
    if (off <= reach && rank < least) {
      least = rank;
      const nearest = t < 0.5 ? parent : node, isOwn = skeleton.axis[nearest] === skeleton.axis[node];
      best = { node: isOwn ? nearest : node, nearest, at: place(skeleton.points, nearest) };
    }
  }
  return best;
}

// The foremost point of the cloud; `woodOnly` those that belong to a node.
export function pickPoint(scene, u, v, woodOnly) {
  const { cloud } = scene.data, near = NEAR_POINT_PX * scene.raster.ratio;
  let best = -1, nearest = 0;
  for (let i = 0; i < cloud.n; i++) {
    if (scene.pointColors[i] === 0 || (woodOnly && cloud.node[i] < 0)) continue;
    const at = place(cloud.positions, i);
    if (scene.isClipped(at)) continue;
    const [pu, pv, inverse] = scene.project(at);
    if (inverse > nearest && Math.abs(pu - u) <= near && Math.abs(pv - v) <= near) { best = i; nearest = inverse; }
  }
  if (best < 0) return null;
  const node = cloud.node[best];
  return { node, nearest: node, at: place(cloud.positions, best) };
}

// A place in space to measure from: a point of the cloud, else of a skeleton.
export function pickPlace(scene, x, y) {
  const u = x * scene.raster.ratio, v = y * scene.raster.ratio;
  const found = (scene.show.cloud && pickPoint(scene, u, v, false)) || pickLine(scene, u, v);
  return found ? found.at : null;
}

export function pickCamera(scene, x, y) {
  if (!scene.show.cameras) return null;
  let best = null, least = NEAR_CAMERA_PX;
  for (const camera of scene.data.cameras) {
    const at = scene.onCanvas(camera.center);
    const off = at ? Math.hypot(at[0] - x, at[1] - y) : Infinity;
    if (off < least) { best = camera; least = off; }
  }
  return best;
}

// The base of a node's branch where it lies so near below the pixel, else the node.
export function snapToBase(scene, { node }) {
  const { skeleton } = scene.data, { screen } = scene.layer;
  const start = node, near = 1.5 * NEAR_PX * scene.raster.ratio;
  for (let now = node; ; now = skeleton.parent[now]) {
    const below = skeleton.parent[now];
    if (below < 0 || skeleton.axis[below] !== skeleton.axis[now]) return now;
    const off = Math.hypot(screen[4 * below] - screen[4 * start], screen[4 * below + 1] - screen[4 * start + 1]);
    if (off > near) return start;
  }
}

// Where a pixel lies on the plane through `at` that faces the eye.
export function onPlaneOf(scene, at, x, y) {
  const [u, v, , scale] = scene.project(at), { right, up } = scene.camera.axes(), { ratio } = scene.raster;
  const dx = (x * ratio - u) / scale, dy = (v - y * ratio) / scale;
  return at.map((value, k) => value + dx * right[k] + dy * up[k]);
}
