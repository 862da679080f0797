// Colours of points and skeletons by what they are, and the legend that says so.

const UNKNOWN = [170, 170, 170];
const RAMP = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]]; // viridis
// By the kinds of bearing.csv, in their order; colours that colour-blind people tell apart (Okabe and Ito, 2008)
const WOOD = [
  ["one-year shoot", [230, 159, 0]], ["spur", [204, 121, 167]], ["two-year wood", [86, 180, 233]], ["older", [90, 90, 90]],
];
const UNTOLD = 255; // kind and age of a node that nobody knows
const TOP_SHARE = 0.98; // of the values lie below the end of a scale

export function pack([r, g, b]) { return (0xff000000 | (b << 16) | (g << 8) | r) >>> 0; }
export function css([r, g, b]) { return `rgb(${Math.round(r)},${Math.round(g)},${Math.round(b)})`; }

function ramp(share) {
  const x = Math.min(Math.max(share, 0), 1) * (RAMP.length - 1), i = Math.min(Math.floor(x), RAMP.length - 2);
  return RAMP[i].map((low, k) => Math.round(low + (x - i) * (RAMP[i + 1][k] - low)));
}

// Neighbours in number stand apart in hue: the golden ratio.
function branchColor(id) {
  const hue = ((id * 0.61803398875) % 1) * 6, value = id % 2 ? 0.85 : 0.6, low = value * 0.2;
  return [5, 3, 1].map((k) => {
    const t = (k + hue) % 6;
    return Math.round(255 * (value - (value - low) * Math.max(0, Math.min(t, 4 - t, 1))));
  });
}

// A scale over the values that are numbers: {color(value), low, high}.
function scale(values) {
  const known = Array.from(values).filter((v) => Number.isFinite(v)).sort((a, b) => a - b);
  const low = known[0] ?? 0, high = known[Math.floor(TOP_SHARE * (known.length - 1))] ?? 1;
  const span = high > low ? high - low : 1;
  return { low, high, color: (v) => (Number.isFinite(v) ? ramp((v - low) / span) : UNKNOWN) };
}

// How nodes may be coloured: name -> {title, of(skeleton) -> {color(node), legend}}.
function nodeSchemes(data) {
  const orderColor = (order) => data.order_colors[order % data.order_colors.length];
  const classColor = new Map(data.classes.map((item) => [item.id, item.color]));
  const byScale = (values, unit) => {
    const { low, high, color } = scale(values);
    return { color: (node) => color(values[node]), legend: { low, high, unit } };
  };
  const schemes = {
    order: {
      title: "order",
      of: (s) => ({
        color: (node) => orderColor(s.order[node]),
        legend: { items: [...new Set(s.order)].sort((a, b) => a - b).map((k) => [String(k), orderColor(k)]) },
      }),
    },
    radius: { title: "radius", of: (s) => byScale(s.radius, data.unit) },
    uncertainty: {
      title: "uncertainty of the radius",
      of: (s) => byScale(s.error || new Float32Array(s.n).fill(NaN), data.unit),
    },
    class: {
      title: "class",
      of: (s) => ({ color: (node) => classColor.get(s.label[node]) || UNKNOWN, legend: classLegend(data) }),
    },
    branch: { title: "branch_id", of: (s) => ({ color: (node) => branchColor(s.axis[node]), legend: {} }) },
  };
  const isKnown = (name) => data.skeleton.branches.some((branch) => Number.isFinite(branch[name]));
  if (isKnown("there")) {
    const there = (s, node) => s.branches[s.axis[node]].there;
    schemes.existence = {
      title: "there, by the photos",
      of: (s) => ({
        color: (node) => (Number.isFinite(there(s, node)) ? ramp(there(s, node)) : UNKNOWN),
        legend: { low: 0, high: 1, unit: "" },
      }),
    };
  }
  if (isKnown("light")) {
    schemes.light = {
      title: "light",
      of: (s) => byScale(Float32Array.from(s.axis, (id) => s.branches[id].light ?? NaN), "of the sky"),
    };
  }
  if (data.skeleton.kind) {
    schemes.kind = {
      title: "kind of wood",
      of: (s) => ({
        color: (node) => (WOOD[s.kind?.[node]] || [, UNKNOWN])[1],
        legend: { items: WOOD },
      }),
    };
    schemes.age = {
      title: "age of wood",
      of: (s) => byScale(Float32Array.from(s.age || [], (age) => (age === UNTOLD ? NaN : age)), "years"),
    };
  }
  return schemes;
}

function classLegend(data) { return { items: data.classes.map((item) => [item.name, item.color]) }; }

export class Colors {
  constructor(data) {
    this.data = data;
    this.nodes = nodeSchemes(data);
    const { cloud } = data;
    this.points = {};
    this.points.photo = {
      title: cloud.hasColor ? "photo" : "height",
      of: () => ({ color: (i) => [cloud.rgb[3 * i], cloud.rgb[3 * i + 1], cloud.rgb[3 * i + 2]], legend: {} }),
    };
    const classColor = new Map(data.classes.map((item) => [item.id, item.color]));
    this.points.class = {
      title: "class",
      of: () => ({ color: (i) => classColor.get(cloud.label[i]) || UNKNOWN, legend: classLegend(data) }),
    };
    if (cloud.confidence) {
      this.points.confidence = {
        title: "confidence of the class",
        of: () => ({ color: (i) => ramp(cloud.confidence[i] / 255), legend: { low: 0, high: 1, unit: "" } }),
      };
    }
    if (cloud.removed) {
      const reasons = new Map(data.removals.map((item) => [item.id, item.color]));
      const present = data.removals.filter((item) => cloud.removed.includes(item.id));
      this.points.removed = {
        title: "taken out by",
        of: () => ({
          color: (i) => reasons.get(cloud.removed[i]) || UNKNOWN,
          legend: { items: present.map((item) => [item.name, item.color]) },
        }),
      };
    }
    for (const name of ["order", "radius", "uncertainty", "branch"]) {
      this.points[name] = { title: this.nodes[name].title, of: () => this.ofPoints(name) };
    }
  }

  ofPoints(name) {
    const { cloud, skeleton } = this.data;
    const { color, legend } = this.nodes[name].of(skeleton);
    return { color: (i) => (cloud.node[i] < 0 ? UNKNOWN : color(cloud.node[i])), legend };
  }
}

export function packAll(n, color) {
  const packed = new Uint32Array(n);
  for (let i = 0; i < n; i++) packed[i] = pack(color(i));
  return packed;
}

export function showLegend(box, title, legend, ramped = RAMP) {
  box.replaceChildren();
  if (!legend.items && legend.high === undefined) return;
  box.append(title + ": ");
  for (const [name, color] of legend.items || []) {
    const chip = document.createElement("span");
    chip.className = "chip";
    chip.style.background = css(color);
    box.append(chip, name + " ");
  }
  if (legend.high === undefined) return;
  const bar = document.createElement("span");
  bar.className = "ramp";
  bar.style.background = `linear-gradient(to right, ${ramped.map(css).join(",")})`;
  box.append(number(legend.low) + " ", bar, ` ${number(legend.high)} ${legend.unit}`);
}

export function number(value, digits = 3) {
  if (!Number.isFinite(value)) return "–";
  return Number(value.toPrecision(digits)).toString();
}
