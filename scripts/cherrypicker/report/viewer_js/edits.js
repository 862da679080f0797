// Hand corrections of a skeleton as cherrypicker.skeleton.edits applies them, and their YAML.
import { place } from "viewer/data.js";
import { GONE, NEW, OFF, SOUND } from "viewer/scene.js";

const PLACES = { connect: ["from", "to"], cut: ["at"], delete: ["at"], move: ["from", "to"] };

// Changes the points and parents of a skeleton, and says in `state` what became of each node.
export class EditedTree {
  constructor(skeleton, state) {
    this.skeleton = skeleton;
    this.state = state;
    this.original = { points: skeleton.points.slice(), parent: skeleton.parent.slice() };
    this.replay([]);
  }

  // Edits are {kind, nodes, places}; the nodes of the skeleton as the page got it.
  replay(edits) {
    const { skeleton, state } = this;
    skeleton.points.set(this.original.points);
    skeleton.parent.set(this.original.parent);
    state.fill(SOUND);
    this.alive = new Uint8Array(skeleton.n).fill(1);
    for (const edit of edits) this.apply(edit);
    const kept = this.beyond(0);
    const touched = new Set(edits.filter((e) => e.kind !== "cut").map((e) => e.nodes[0]));
    for (let node = 0; node < skeleton.n; node++) {
      state[node] = !this.alive[node] ? GONE : !kept[node] ? OFF : touched.has(node) ? NEW : SOUND;
    }
  }

  // Why an edit cannot be, "" where it can.
  refusal({ kind, nodes }) {
    const [start, target] = nodes;
    if (nodes.some((node) => !this.alive[node])) return "this wood is deleted";
    if ((kind === "cut" || kind === "delete") && start === 0) return `this ${kind} would remove the root`;
    if (kind === "cut" && this.skeleton.parent[start] < 0) return "this wood is off already";
    if (kind !== "connect") return "";
    if (start === target) return "these are one place";
    if (this.wayDown(target).includes(start)) return "this would close a cycle: 'to' lies beyond 'from'";
    const isOff = (node) => this.wayDown(node).at(-1) !== 0;
    if (!isOff(start) && isOff(target)) return "'to' lies on a piece that is off: connect the piece to the tree";
    return "";
  }

  apply({ kind, nodes, places }) {
    const { parent, points } = this.skeleton, [start, target] = nodes;
    if (kind === "move") points.set(places.to, 3 * start);
    else if (kind === "cut") parent[start] = -1;
    else if (kind === "delete") this.beyond(start).forEach((is, node) => { if (is) this.alive[node] = 0; });
    else {
      if (this.wayDown(start).at(-1) !== this.wayDown(target).at(-1)) this.hangFrom(start);
      parent[start] = target;
    }
  }

  wayDown(node) {
    const way = [node], { parent } = this.skeleton;
    while (parent[way.at(-1)] >= 0) way.push(parent[way.at(-1)]);
    return way;
  }

  // Turn a piece's parents round so that it hangs from a node.
  hangFrom(node) {
    const way = this.wayDown(node), { parent } = this.skeleton;
    for (let i = way.length - 1; i > 0; i--) parent[way[i]] = way[i - 1];
    parent[node] = -1;
  }

  // 1 for a node and all that hangs on it.
  beyond(node) {
    const { parent, n } = this.skeleton, known = new Int8Array(n).fill(-1);
    known[node] = 1;
    for (let i = 0; i < n; i++) {
      const way = [];
      let now = i;
      while (now >= 0 && known[now] < 0) { way.push(now); now = parent[now]; }
      const is = now < 0 ? 0 : known[now];
      for (const each of way) known[each] = is;
    }
    return known.map((is, i) => (is && this.alive[i] ? 1 : 0));
  }

  length() {
    const { skeleton, state } = this;
    let sum = 0;
    for (let node = 1; node < skeleton.n; node++) {
      if (state[node] === GONE || state[node] === OFF || skeleton.parent[node] < 0) continue;
      const a = place(skeleton.points, node), b = place(skeleton.points, skeleton.parent[node]);
      sum += Math.hypot(a[0] - b[0], a[1] - b[1], a[2] - b[2]);
    }
    return sum;
  }
}

// One line of a block list of YAML, places in the skeleton's own frame.
export function yamlLine({ kind, places }, origin, indent) {
  const text = (at) => `[${at.map((v, k) => Number((v + origin[k]).toFixed(5))).join(", ")}]`;
  const inside = PLACES[kind].map((name) => `${name}: ${text(places[name])}`).join(", ");
  return `${indent}- ${kind}: {${inside}}\n`;
}

// The edits of lines that `yamlLine` wrote; null where a line is another's.
export function parseLines(text, origin) {
  const edits = [];
  for (const line of text.split("\n").filter((each) => each.trim())) {
    const [, kind, inside] = line.match(/^\s*- (connect|cut|delete|move): \{(.*)\}\s*$/) || [];
    if (!kind) return null;
    const places = {};
    for (const [, name, numbers] of inside.matchAll(/(\w+): \[([^\]]*)\]/g)) {
      places[name] = numbers.split(",").map((v, k) => Number(v) - origin[k]);
    }
    const isWhole = PLACES[kind].every((name) => places[name]?.length === 3 && places[name].every(Number.isFinite));
    if (!isWhole) return null;
    edits.push({ kind, places });
  }
  return edits;
}

// The nodes that an edit's places mean, as the next run finds them: the nearest living ones.
export function nodesOf({ kind, places }, tree) {
  const anchors = kind === "move" ? ["from"] : PLACES[kind], { points, n } = tree.skeleton;
  return anchors.map((name) => {
    let best = 0, least = Infinity;
    for (let node = 0; node < n; node++) {
      const off = tree.alive[node] ? Math.hypot(...place(points, node).map((v, k) => v - places[name][k])) : Infinity;
      if (off < least) { best = node; least = off; }
    }
    return best;
  });
}
