// What the page carries as text, as typed arrays. Places are relative to `origin`.

export async function loadData(raw) {
  const data = { ...raw, skeleton: await loadSkeleton(raw.skeleton) };
  data.cloud = await loadCloud(raw.cloud);
  return data;
}

async function unpack(text, Kind) {
  const letters = atob(text), bytes = new Uint8Array(letters.length);
  for (let i = 0; i < letters.length; i++) bytes[i] = letters.charCodeAt(i);
  const unzipped = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Kind(await new Response(unzipped).arrayBuffer());
}

async function loadCloud(raw) {
  const bytes = await unpack(raw.positions, Uint8Array), n = bytes.length / 6;
  const positions = new Float32Array(3 * n);
  for (let k = 0; k < 3; k++) {
    const low = bytes.subarray(2 * k * n), high = bytes.subarray((2 * k + 1) * n);
    for (let i = 0; i < n; i++) positions[3 * i + k] = raw.low[k] + ((low[i] + 256 * high[i]) / 65535) * raw.span[k];
  }
  return {
    positions,
    rgb: await unpack(raw.colors, Uint8Array),
    label: await unpack(raw.labels, Uint8Array),
    confidence: raw.confidence ? await unpack(raw.confidence, Uint8Array) : null,
    removed: raw.removed ? await unpack(raw.removed, Uint8Array) : null, // what took a point out, 0 nothing
    node: await unpack(raw.nodes, Int32Array), // nearest of the skeleton, -1 off the wood
    hasColor: raw.has_color,
    n, // of which the first are a sample of all
    first: raw.first,
  };
}

async function loadSkeleton(raw) {
  const skeleton = {
    points: await unpack(raw.points, Float32Array),
    parent: await unpack(raw.parent, Int32Array),
    radius: await unpack(raw.radius, Float32Array),
    error: raw.error ? await unpack(raw.error, Float32Array) : null,
    axis: await unpack(raw.axis, Int32Array), // the number of its branch
    label: await unpack(raw.label, Uint8Array),
    kind: raw.kind ? await unpack(raw.kind, Uint8Array) : null, // of the wood below each node
    age: raw.age ? await unpack(raw.age, Uint8Array) : null,
    branches: raw.branches, // what is known of each, in the order of their numbers
  };
  skeleton.n = skeleton.parent.length;
  skeleton.order = Int32Array.from(skeleton.axis, (row) => skeleton.branches[row].order);
  return skeleton;
}

export function place(points, node) { return [points[3 * node], points[3 * node + 1], points[3 * node + 2]]; }
