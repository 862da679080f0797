// What the page carries as text, as typed arrays. Places are relative to `origin`.

export function loadData(raw) {
  const data = { ...raw, skeletons: raw.skeletons.map(loadSkeleton) };
  data.cloud = raw.cloud ? loadCloud(raw.cloud) : null;
  return data;
}

function unpack(text, Kind) {
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  return new Kind(bytes.buffer);
}

function loadCloud(raw) {
  const steps = unpack(raw.positions, Uint16Array), positions = new Float32Array(steps.length);
  for (let i = 0; i < steps.length; i++) positions[i] = raw.low[i % 3] + (steps[i] / 65535) * raw.span[i % 3];
  return {
    positions,
    rgb: unpack(raw.colors, Uint8Array),
    label: unpack(raw.labels, Uint8Array),
    confidence: raw.confidence ? unpack(raw.confidence, Uint8Array) : null,
    removed: raw.removed ? unpack(raw.removed, Uint8Array) : null, // what took a point out, 0 nothing
    node: unpack(raw.nodes, Int32Array), // nearest of the first skeleton, -1 off the wood
    hasColor: raw.has_color,
    n: steps.length / 3,
  };
}

function loadSkeleton(raw) {
  const skeleton = {
    name: raw.name,
    points: unpack(raw.points, Float32Array),
    parent: unpack(raw.parent, Int32Array),
    radius: unpack(raw.radius, Float32Array),
    error: raw.error ? unpack(raw.error, Float32Array) : null,
    axis: unpack(raw.axis, Int32Array), // the number of its branch
    label: unpack(raw.label, Uint8Array),
    branches: raw.branches, // what is known of each, in the order of their numbers
    tint: raw.tint || null, // the one colour of a skeleton that is shown beside another
  };
  skeleton.n = skeleton.parent.length;
  skeleton.order = Int32Array.from(skeleton.axis, (row) => skeleton.branches[row].order);
  return skeleton;
}

export function place(points, node) { return [points[3 * node], points[3 * node + 1], points[3 * node + 2]]; }
