// What is left of a tree when limbs go: plain reckoning over the JSON in the page.
"use strict";
(() => {
  const box = document.getElementById("limbs");
  if (!box) return;
  const data = JSON.parse(document.getElementById("limbs-data").textContent);
  const gone = new Set();
  const SVG = "http://www.w3.org/2000/svg", WAYS = 180, NEAR = 1e-7;

  const sub = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) =>
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

  function face(points, a, b, c, inside) {
    let normal = cross(sub(points[b], points[a]), sub(points[c], points[a]));
    const size = Math.hypot(...normal);
    normal = normal.map((x) => x / (size || 1));
    if (dot(normal, sub(inside, points[a])) > 0)
      return { at: [a, c, b], normal: normal.map((x) => -x) };
    return { at: [a, b, c], normal };
  }

  // The farthest of some points by a measure, or -1 where none has any.
  function farthest(points, measure) {
    let best = -1, most = NEAR;
    points.forEach((p, row) => { const m = measure(p); if (m > most) { most = m; best = row; } });
    return best;
  }

  // Volume of the convex hull, built point by point: faces that a point sees give way to others.
  function hullVolume(points) {
    if (points.length < 4) return 0;
    const a = points[0];
    const second = farthest(points, (p) => Math.hypot(...sub(p, a)));
    if (second < 0) return 0;
    const ab = sub(points[second], a);
    const third = farthest(points, (p) => Math.hypot(...cross(ab, sub(p, a))));
    if (third < 0) return 0;
    const across = cross(ab, sub(points[third], a));
    const fourth = farthest(points, (p) => Math.abs(dot(across, sub(p, a))));
    if (fourth < 0) return 0;
    const first = [0, second, third, fourth];
    const inside = [0, 1, 2].map((k) => first.reduce((sum, row) => sum + points[row][k] / 4, 0));
    let faces = [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]
      .map((each) => face(points, ...each.map((row) => first[row]), inside));
    points.forEach((p, row) => {
      const seen = faces.filter((f) => dot(f.normal, sub(p, points[f.at[0]])) > NEAR);
      if (!seen.length) return;
      const edges = new Map();
      for (const { at } of seen)
        for (const [i, j] of [[at[0], at[1]], [at[1], at[2]], [at[2], at[0]]])
          if (!edges.delete(`${j},${i}`)) edges.set(`${i},${j}`, [i, j]);
      const hidden = new Set(seen);
      faces = faces.filter((f) => !hidden.has(f));
      for (const [i, j] of edges.values()) faces.push(face(points, i, j, row, inside));
    });
    return faces.reduce((sum, { at }) => {
      const [p, q, r] = at.map((row) => sub(points[row], inside));
      return sum + Math.abs(dot(p, cross(q, r))) / 6;
    }, 0);
  }

  // Mean of the widest horizontal extent, to whole degrees, and that across it.
  function width(points) {
    if (!points.length) return 0;
    const extent = Array.from({ length: WAYS }, (_, degree) => {
      const x = Math.cos(degree * Math.PI / WAYS), y = Math.sin(degree * Math.PI / WAYS);
      let low = Infinity, high = -Infinity;
      for (const p of points) {
        const along = p[0] * x + p[1] * y;
        low = Math.min(low, along); high = Math.max(high, along);
      }
      return high - low;
    });
    const widest = extent.indexOf(Math.max(...extent));
    return (extent[widest] + extent[(widest + WAYS / 2) % WAYS]) / 2;
  }

  function measure() {
    const left = data.limbs.filter((limb) => !gone.has(limb.branch_id));
    const sum = (name) => left.reduce((total, limb) => total + limb[name], 0);
    const points = left.reduce((all, limb) => all.concat(limb.hull), data.stem.hull.slice());
    return { n: left.length, ratio: data.ratio * sum("area_cm2") / data.area,
      length: data.stem.wood_length_m + sum("wood_length_m"), volume: data.stem.wood_volume_m3 + sum("wood_volume_m3"),
      hull: hullVolume(points), width: width(points) };
  }

  const whole = measure();
  const share = (value, of) => (of > 0 ? value / of : 0);
  const liters = data.unit === "m";

  function show() {
    const now = measure();
    const crown = data.crown_volume * share(now.hull, whole.hull);
    const wide = data.crown_width * share(now.width, whole.width);
    const rows = {
      n: [whole.n, now.n, 0, ""],
      ratio: [whole.ratio, now.ratio, 2, ""],
      volume: liters ? [1e3 * whole.volume, 1e3 * now.volume, 2, "dm³"]
        : [whole.volume, now.volume, 4, `${data.unit}³`],
      length: [whole.length, now.length, 1, data.unit],
      crown: [data.crown_volume, crown, 2, `${data.unit}³`],
      width: [data.crown_width, wide, 2, data.unit],
    };
    for (const [name, [before, after, digits, unit]] of Object.entries(rows)) {
      const line = box.querySelector(`tr[data-name="${name}"]`);
      line.cells[1].textContent = `${before.toFixed(digits)} ${unit}`.trim();
      line.cells[2].textContent = `${after.toFixed(digits)} ${unit}`.trim();
      const change = 100 * (share(after, before) - 1);
      line.cells[3].textContent = Math.abs(change) < 0.05 ? "" : `${change.toFixed(1)} %`;
    }
    for (const each of box.querySelectorAll("[data-limb]")) {
      const isGone = gone.has(Number(each.dataset.limb));
      each.classList.toggle("gone", isGone);
      each.setAttribute("aria-pressed", isGone);
    }
    document.dispatchEvent(new Event("cellschange"));
  }

  function toggle(id) {
    if (!gone.delete(id)) gone.add(id);
    show();
  }

  function element(name, attributes, text) {
    const made = document.createElementNS(SVG, name);
    for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
    if (text !== undefined) made.textContent = text;
    return made;
  }

  // The stem unrolled: azimuth to the right, height upwards, circles as thick as the limbs are.
  function draw() {
    const map = box.querySelector("svg"), high = Math.max(...data.limbs.map((l) => l.height_m));
    const thick = Math.max(...data.limbs.map((l) => l.diameter_m));
    const x = (degrees) => 46 + 400 * degrees / 360, y = (height) => 268 - 240 * height / high;
    for (const degrees of [0, 90, 180, 270, 360]) {
      map.append(element("line", { x1: x(degrees), x2: x(degrees), y1: 16, y2: 276 }));
      map.append(element("text", { x: x(degrees), y: 292, "text-anchor": "middle" }, `${degrees}°`));
    }
    for (const level of [0, 0.25, 0.5, 0.75, 1]) {
      const height = level * high;
      map.append(element("line", { x1: 46, x2: 446, y1: y(height), y2: y(height) }));
      map.append(element("text", { x: 40, y: y(height) + 4, "text-anchor": "end" }, height.toFixed(2)));
    }
    for (const limb of data.limbs) {
      const at = { cx: x(limb.azimuth_deg), cy: y(limb.height_m), r: 4 + 12 * limb.diameter_m / thick };
      const mark = element("circle", { ...at, "data-limb": limb.branch_id, tabindex: 0, role: "button" });
      mark.append(element("title", {}, `limb ${limb.rank}, axis ${limb.branch_id}`));
      map.append(mark);
      map.append(element("text", { x: at.cx, y: at.cy + 4, "text-anchor": "middle", class: "rank" }, limb.rank));
    }
  }

  draw();
  for (const each of box.querySelectorAll("[data-limb]")) {
    each.addEventListener("click", () => toggle(Number(each.dataset.limb)));
    each.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" && event.key !== " ") return;
      event.preventDefault();
      toggle(Number(each.dataset.limb));
    });
  }
  box.querySelector("[name=largest]").addEventListener("click", () => {
    const next = data.limbs.find((limb) => !gone.has(limb.branch_id));
    if (next) toggle(next.branch_id);
  });
  box.querySelector("[name=all]").addEventListener("click", () => { gone.clear(); show(); });
  show();
})();
