"use strict";
// The batch page's table (sort, filter, columns) and its charts, drawn from the JSON in the page.
// Text from data enters by textContent and setAttribute alone.
(() => {
const batch = JSON.parse(document.getElementById("batch").textContent);
const { traits, trees, pairs, stages } = batch;
const $ = (id) => document.getElementById(id);
const COLORS = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#b58900", "#56b4e9", "#7a5195", "#8c6d31"]; // Okabe and Ito 2008, darkened
const WIDTH = 340, HEIGHT = 220, LEFT = 52, RIGHT = 12, TOP = 26, BELOW = 30;
const RADIUS = trees.length > 100 ? 3 : 4, MOST_NAMES = 8;
const series = [...new Set(trees.map((tree) => tree.series).filter(Boolean))].sort();
let shown = new Set(trees.keys());
let by = "all";

const SVG = "http://www.w3.org/2000/svg";
function draw(parent, name, attributes = {}, text = null) {
  const node = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) node.setAttribute(key, value);
  if (text !== null) node.textContent = text;
  parent.append(node);
  return node;
}
function make(parent, name, properties = {}) {
  const node = Object.assign(document.createElement(name), properties);
  parent.append(node);
  return node;
}
const quantile = (sorted, share) => {
  const at = share * (sorted.length - 1), low = Math.floor(at);
  return sorted[low] + (at - low) * (sorted[Math.min(low + 1, sorted.length - 1)] - sorted[low]);
};
const plain = (value) => Number(value.toPrecision(4)).toString();
function roundTicks(low, high, most = 5) {
  const power = 10 ** Math.floor(Math.log10((high - low) / most));
  const step = power * [1, 2, 5, 10].find((each) => (high - low) / (each * power) <= most);
  const found = [];
  for (let index = Math.ceil(low / step); index * step <= high; index++) found.push(Number((index * step).toPrecision(12)));
  return found;
}
function logTicks(low, high) {
  const found = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++)
    for (const each of high / low > 100 ? [1] : high / low > 8 ? [1, 2, 5] : [1, 1.5, 2, 3, 4, 5, 7])
      if (each * 10 ** power >= low && each * 10 ** power <= high) found.push(Number((each * 10 ** power).toPrecision(6)));
  return found;
}
const padded = (low, high, share = 0.06) => {
  const pad = share * (high - low) || 0.05 * Math.abs(high) || 1;
  return [low - pad, high + pad];
};
function chart(parent, title, height = HEIGHT) {
  const figure = make(parent, "figure");
  const svg = draw(figure, "svg", { viewBox: `0 0 ${WIDTH} ${height}`, role: "group", "aria-label": title });
  draw(svg, "text", { x: 8, y: 15, class: "title" }, title);
  return svg;
}
function yAxis(svg, ticks, y) {
  for (const tick of ticks) {
    draw(svg, "line", { x1: LEFT, x2: WIDTH - RIGHT, y1: y(tick), y2: y(tick) });
    draw(svg, "text", { x: LEFT - 5, y: y(tick) + 4, "text-anchor": "end" }, plain(tick));
  }
}

// A tree's point: a link to its page, told by the tip, marked wherever it stands.
function point(svg, index, x, y, told, isApart = false) {
  const tree = trees[index];
  const link = tree.href ? draw(svg, "a", { href: tree.href }) : svg;
  const mark = draw(link, "circle", { cx: x.toFixed(1), cy: y.toFixed(1), r: RADIUS, "data-tree": index });
  if (isApart) mark.classList.add("apart");
  mark.style.setProperty("--color", colorOf(tree));
  draw(mark, "title", {}, `${tree.tree}: ${told}`);
  mark.told = `${tree.tree}\n${told}${tree.date || tree.series ? "\n" : ""}${[tree.series, tree.date].filter(Boolean).join(", ")}`;
}
function nameBeside(svg, index, x, y) {
  const isRight = x > 0.65 * WIDTH;
  draw(svg, "text", { class: "apart", x: x + (isRight ? -7 : 7), y: y + 4, "text-anchor": isRight ? "end" : "start" }, trees[index].tree);
}
const colorOf = (tree) => colorOfSeries(tree.series);
const colorOfSeries = (name) => (name && series.length <= COLORS.length ? COLORS[series.indexOf(name)] : "var(--mark)");

const tip = $("tip");
function tell(event) {
  const mark = event.target.closest?.("circle[data-tree]");
  for (const node of document.querySelectorAll(".hot")) node.classList.remove("hot");
  tip.hidden = !mark;
  if (!mark) return;
  for (const node of document.querySelectorAll(`circle[data-tree="${mark.dataset.tree}"]`)) node.classList.add("hot");
  rows[mark.dataset.tree].classList.add("hot");
  tip.replaceChildren();
  const picture = rows[mark.dataset.tree].querySelector("img");
  if (picture) tip.append(picture.cloneNode());
  make(tip, "span", { textContent: mark.told });
  const box = mark.getBoundingClientRect();
  tip.style.left = `${Math.min(box.right + 8, innerWidth - tip.offsetWidth - 8)}px`;
  tip.style.top = `${Math.min(box.bottom + 8, innerHeight - tip.offsetHeight - 8)}px`;
}
document.addEventListener("mouseover", tell);

// Groups along a strip's x axis: one, one a series, or days.
function groupsOf(indices) {
  if (by === "series") {
    const names = [...new Set(indices.map((index) => trees[index].series))].sort();
    const step = (WIDTH - LEFT - RIGHT) / names.length;
    return { at: (index) => LEFT + (names.indexOf(trees[index].series) + 0.5) * step, step, ticks: names.map((name, place) => [LEFT + (place + 0.5) * step, name || "none"]) };
  }
  if (by === "date") {
    const days = [...new Set(indices.map((index) => Date.parse(trees[index].date)))].sort((a, b) => a - b);
    const [low, high] = padded(days[0], days.at(-1), 0.1);
    const at = (day) => LEFT + ((day - low) / (high - low)) * (WIDTH - LEFT - RIGHT);
    const every = Math.ceil(days.length / 4);
    const gaps = days.slice(1).map((day, place) => at(day) - at(days[place]));
    return { at: (index) => at(Date.parse(trees[index].date)), step: Math.min(60, ...gaps), ticks: days.filter((_, place) => place % every === 0).map((day) => [at(day), new Date(day).toISOString().slice(0, 10)]) };
  }
  const step = WIDTH - LEFT - RIGHT;
  return { at: () => LEFT + step / 2, step, ticks: [] };
}
// Points of one group move aside until they touch no other, as far as the group's room allows.
function aside(placed, x, y, room) {
  const near = placed.filter((other) => Math.abs(other.y - y) < 2 * RADIUS && Math.abs(other.middle - x) < 0.5);
  for (let step = 0; step * RADIUS < room; step++)
    for (const side of step ? [1, -1] : [1]) {
      const there = x + side * step * RADIUS;
      if (near.every((other) => (other.x - there) ** 2 + (other.y - y) ** 2 >= 4 * RADIUS ** 2)) return there;
    }
  return x;
}
function strip(parent, trait, place) {
  const usable = [...shown].filter((index) => trees[index].values[place] !== null && (by !== "date" || trees[index].date));
  if (!usable.length) return;
  const svg = chart(parent, trait.unit ? `${trait.title} [${trait.unit}]` : trait.title);
  const value = (index) => trees[index].values[place], error = (index) => trees[index].errors[place] ?? 0;
  const ends = usable.flatMap((index) => [value(index) - error(index), value(index) + error(index)]);
  const [low, high] = padded(Math.min(...ends), Math.max(...ends));
  const y = (number) => TOP + ((high - number) / (high - low)) * (HEIGHT - TOP - BELOW);
  yAxis(svg, roundTicks(low, high), y);
  const groups = groupsOf(usable);
  const crowded = groups.ticks.length > MOST_NAMES;
  for (const [x, name] of groups.ticks) if (!crowded) draw(svg, "text", { x, y: HEIGHT - 10, "text-anchor": "middle" }, name);
  if (by === "date") {
    for (const name of series) {
      const scans = usable.filter((index) => trees[index].series === name).sort((a, b) => trees[a].date.localeCompare(trees[b].date));
      if (scans.length < 2) continue;
      const line = draw(svg, "polyline", { class: "run", points: scans.map((index) => `${groups.at(index).toFixed(1)},${y(value(index)).toFixed(1)}`).join(" ") });
      line.style.setProperty("--color", colorOfSeries(name));
    }
  } else {
    for (const x of new Set(usable.map(groups.at))) {
      const members = usable.filter((index) => groups.at(index) === x);
      const middle = quantile(members.map(value).sort((a, b) => a - b), 0.5), half = Math.min(groups.step * 0.42, 60);
      draw(svg, "line", { class: "median", x1: x - half, x2: x + half, y1: y(middle), y2: y(middle) });
    }
  }
  const placed = [], apart = new Set(trait.apart);
  for (const index of [...usable].sort((a, b) => value(a) - value(b))) {
    const middle = groups.at(index), up = y(value(index));
    const x = by === "date" ? middle : aside(placed, middle, up, groups.step * 0.45);
    placed.push({ x, y: up, middle });
    if (error(index) && usable.length <= 40) {
      const bar = draw(svg, "line", { class: "bar", x1: x, x2: x, y1: y(value(index) - error(index)), y2: y(value(index) + error(index)) });
      bar.style.setProperty("--color", colorOf(trees[index]));
    }
    const spread = error(index) ? ` ± ${Number(error(index).toPrecision(2))}` : "";
    point(svg, index, x, up, `${plain(value(index))}${spread} ${trait.unit}`, apart.has(index));
    if (apart.has(index)) nameBeside(svg, index, x, up);
  }
}

function scatter(parent, pair) {
  const [column, row] = [pair.x, pair.y].map((name) => traits.findIndex((trait) => trait.name === name));
  const usable = [...shown].filter((index) => trees[index].values[column] > 0 && trees[index].values[row] > 0);
  if (!usable.length) return;
  const titles = [traits[column], traits[row]].map((trait) => `${trait.title} [${trait.unit}]`);
  const height = 300, svg = chart(parent, titles[1], height);
  const scale = (place, from, to) => {
    const logs = usable.map((index) => Math.log(trees[index].values[place]));
    const [low, high] = padded(Math.min(...logs), Math.max(...logs));
    const at = (number) => from + ((Math.log(number) - low) / (high - low)) * (to - from);
    return [at, logTicks(Math.exp(low), Math.exp(high)), Math.exp(low), Math.exp(high)];
  };
  const [x, xTicks, xLow, xHigh] = scale(column, LEFT, WIDTH - RIGHT);
  const [y, yTicks, yLow, yHigh] = scale(row, height - BELOW - 12, TOP);
  yAxis(svg, yTicks, y);
  for (const tick of xTicks) draw(svg, "text", { x: x(tick), y: height - BELOW + 4, "text-anchor": "middle" }, plain(tick));
  draw(svg, "text", { x: WIDTH - RIGHT, y: height - 8, "text-anchor": "end" }, titles[0]);
  if (pair.line) {
    const [factor, power] = pair.line, on = (number) => factor * number ** power;
    const inside = (number) => Math.min(Math.max(number, Math.min((yLow / factor) ** (1 / power), (yHigh / factor) ** (1 / power))), Math.max((yLow / factor) ** (1 / power), (yHigh / factor) ** (1 / power)));
    const from = power ? inside(xLow) : xLow, to = power ? inside(xHigh) : xHigh;
    draw(svg, "line", { class: "fit", x1: x(from), y1: y(on(from)), x2: x(to), y2: y(on(to)) });
  }
  const apart = new Set(pair.apart);
  for (const index of usable) {
    const [a, b] = [trees[index].values[column], trees[index].values[row]];
    point(svg, index, x(a), y(b), `${plain(a)} ${traits[column].unit}, ${plain(b)} ${traits[row].unit}`, apart.has(index));
    if (apart.has(index)) nameBeside(svg, index, x(a), y(b));
  }
}

// One row a stage, one point a tree, a logarithmic scale.
function costs(parent, title, unit, place) {
  const name = 120, line = 20, height = TOP + line * stages.length + BELOW;
  const numbers = stages.flatMap((stage) => stage.jobs.map((job) => job[place])).filter((number) => number > 0);
  if (!numbers.length) return;
  const svg = chart(parent, `${title} [${unit}]`, height);
  const [low, high] = padded(Math.log(Math.min(...numbers)), Math.log(Math.max(...numbers)));
  const x = (number) => name + ((Math.log(number) - low) / (high - low)) * (WIDTH - RIGHT - name);
  for (const tick of logTicks(Math.exp(low), Math.exp(high))) {
    draw(svg, "line", { x1: x(tick), x2: x(tick), y1: TOP, y2: height - BELOW });
    draw(svg, "text", { x: x(tick), y: height - BELOW + 14, "text-anchor": "middle" }, plain(tick));
  }
  stages.forEach((stage, row) => {
    const y = TOP + line * (row + 0.5);
    draw(svg, "text", { x: name - 6, y: y + 4, "text-anchor": "end" }, stage.rule);
    for (const job of stage.jobs) if (job[place] > 0 && shown.has(job[0])) point(svg, job[0], x(job[place]), y, `${stage.rule}, ${plain(job[place])} ${unit}`);
  });
}

function drawCharts() {
  for (const id of ["strips", "scatters", "costs", "legend"]) $(id)?.replaceChildren();
  traits.forEach((trait, place) => strip($("strips"), trait, place));
  pairs.forEach((pair) => scatter($("scatters"), pair));
  if ($("costs")) { costs($("costs"), "Time of a job", "s", 1); costs($("costs"), "Memory of a job", "GB", 2); }
  if (series.length > 1 && series.length <= COLORS.length) for (const name of series) {
    const item = make($("legend"), "span");
    make(item, "i").style.setProperty("--color", colorOfSeries(name));
    item.append(name);
  }
}

// The table.
const table = $("trees"), body = table.tBodies[0], heads = [...table.tHead.rows[0].cells];
const rows = [...body.rows];
const names = heads.map((head) => head.dataset.name ?? "");
const texts = rows.map((row) => row.textContent.toLowerCase());
const valueOf = (row, column) => {
  const cell = row.cells[column];
  return cell.dataset.v === undefined ? cell.textContent.trim() : cell.dataset.v === "" ? null : Number(cell.dataset.v);
};
function sortBy(column, direction = heads[column].getAttribute("aria-sort") === "ascending" ? -1 : 1) {
  for (const head of heads) head.removeAttribute("aria-sort");
  heads[column].setAttribute("aria-sort", direction > 0 ? "ascending" : "descending");
  const compare = (a, b) => (typeof a === "number" ? a - b : a.localeCompare(b, "en", { numeric: true }));
  const empty = (value) => value === null || value === "";
  const keyed = rows.map((row) => [row, valueOf(row, column)]);
  keyed.sort(([, a], [, b]) => (empty(a) || empty(b) ? empty(a) - empty(b) : direction * compare(a, b)));
  body.append(...keyed.map(([row]) => row));
}
heads.forEach((head, column) => {
  const button = document.createElement("button");
  button.type = "button";
  button.append(...head.childNodes);
  head.append(button);
  button.addEventListener("click", () => sortBy(column));
});
$("order")?.addEventListener("change", ({ target }) => {
  if (target.value) return sortBy(names.indexOf(target.value), target.selectedOptions[0].dataset.down === "true" ? -1 : 1);
  for (const head of heads) head.removeAttribute("aria-sort");
  body.append(...rows);
});
// A term is a word of the row, or a trait with a bound.
function accepts(term) {
  const [, name, sign, number] = term.match(/^([a-z0-9_]+)(<=|>=|<|>|=)(-?[\d.]+)$/) ?? [];
  const column = names.findIndex((each) => name && (each.startsWith(name) || each.startsWith(`n_${name}`)));
  if (name === "warnings") return (index) => compareBy(sign, valueOf(rows[index], heads.length - 1), Number(number));
  if (column < 0) return (index) => texts[index].includes(term);
  return (index) => compareBy(sign, valueOf(rows[index], column), Number(number));
}
const compareBy = (sign, a, b) => a !== null && { "<": a < b, ">": a > b, "<=": a <= b, ">=": a >= b, "=": a === b }[sign];
function filter() {
  const tests = $("filter").value.toLowerCase().split(/\s+/).filter(Boolean).map(accepts);
  const wanted = $("series").value;
  shown = new Set([...trees.keys()].filter((index) => (wanted === "*" || trees[index].series === wanted) && tests.every((test) => test(index))));
  rows.forEach((row, index) => { row.hidden = !shown.has(index); });
  $("count").textContent = `${shown.size} of ${trees.length} trees`;
  drawCharts();
}
let waiting = 0;
$("filter").addEventListener("input", () => { clearTimeout(waiting); waiting = setTimeout(filter, 120); });
for (const [value, text] of [["*", "all"], ...series.map((name) => [name, name])]) make($("series"), "option", { value, textContent: text });
$("series").addEventListener("change", filter);
$("series").parentElement.hidden = series.length < 1;
heads.forEach((head, column) => {
  if (!column) return;
  const label = make($("columns").querySelector("div"), "label");
  const box = make(label, "input", { type: "checkbox", checked: true });
  label.append(` ${head.textContent}`);
  box.addEventListener("change", () => { for (const row of table.rows) row.cells[column].hidden = !box.checked; });
});
for (const box of document.querySelectorAll('input[name="by"]')) {
  box.disabled = (box.value === "series" && !series.length) || (box.value === "date" && new Set(trees.map((tree) => tree.date)).size < 2);
  box.addEventListener("change", () => { by = box.value; drawCharts(); });
}
for (const node of document.querySelectorAll(".tools, #filter-help, #charts, #costs")) node.hidden = false;
filter();
})();
