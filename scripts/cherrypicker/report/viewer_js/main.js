// The view of one page: `initViewer(box, raw)` with the data that viewer.py writes.
import { readHash, writeHash } from "viewer/camera.js";
import { css, number, showLegend } from "viewer/colors.js";
import { loadData, place } from "viewer/data.js";
import { Editor } from "viewer/editor.js";
import { openPhoto } from "viewer/photos.js";
import { pickCamera, pickPlace, pickWood } from "viewer/picking.js";
import { Scene } from "viewer/scene.js";
import { steer } from "viewer/steering.js";
import { BranchTable } from "viewer/table.js";

const HASH_MS = 250; // after the last motion

export async function initViewer(box, raw) {
  const data = await loadData(raw), scene = new Scene(box.querySelector("canvas"), data);
  return new Viewer(box, scene, data);
}

class Viewer {
  constructor(box, scene, data) {
    Object.assign(this, { box, scene, data, tool: "look", measured: [], branch: null });
    this.part = (name) => box.querySelector(`[data-part=${name}]`);
    const tables = box.dataset.tables.split(" ").map((id) => document.getElementById(id)).filter((table) => table);
    this.tables = tables.map((table) => new BranchTable(table, (id) => this.pickBranch(id, { fly: true })));
    [this.table] = this.tables; // whose rows the keys go through
    this.editor = data.edits && new Editor(scene, this.part("edit"), data.edits);
    this.fillControls();
    steer(scene, (x, y) => this.click(x, y));
    scene.canvas.addEventListener("keydown", (e) => this.key(e));
    scene.canvas.addEventListener("dblclick", () => { if (this.tool === "look") { scene.camera.reset(); scene.redraw(); } });
    scene.afterDraw.push(() => this.placeLabel(), () => this.rememberSoon());
    window.addEventListener("hashchange", () => this.restore());
    window.addEventListener("beforeprint", () => {
      scene.draw();
      this.remember();
      for (const each of document.querySelectorAll("[data-address]")) each.textContent = location.href;
    });
    this.restore();
    scene.redraw();
  }

  // ---- controls ---------------------------------------------------------------------------------
  fillControls() {
    const { box, scene, data } = this;
    this.fillSelect("points", scene.colors.points);
    this.fillSelect("skeleton", scene.colors.nodes);
    for (const { id, name, color } of data.classes) this.part("classes").append(checkBox("class", id, name, color));
    if (!data.cameras.length) box.querySelector("[name=show-cameras]").parentElement.hidden = true;
    if (!this.editor) box.querySelector("[name=tool][value=edit]").parentElement.hidden = true;
    box.addEventListener("input", (e) => this.change(e.target));
    box.addEventListener("click", (e) => { const act = e.target.dataset.act; if (act) this[act](); });
  }

  fillSelect(name, schemes) {
    const select = this.box.querySelector(`select[name=${name}]`);
    for (const [key, { title }] of Object.entries(schemes)) select.append(new Option(title, key));
    select.value = this.scene.schemes[name];
  }

  change({ name, value, checked }) {
    const { scene } = this;
    if (name === "points" || name === "skeleton") scene.schemes[name] = value;
    else if (name === "size") scene.size = Number(value);
    else if (name === "class") scene.hidden[checked ? "delete" : "add"](Number(value));
    else if (name === "tool") return this.choose(value);
    else if (name.startsWith("clip")) return this.setClip();
    else if (name.startsWith("show-")) scene.show[name.slice(5)] = checked;
    else return;
    this.recolor();
  }

  recolor() {
    const { scene } = this;
    scene.recolor();
    for (const [name, scheme, title] of [
      ["points", scene.pointScheme, scene.colors.points[scene.schemes.points]?.title],
      ["skeleton", scene.layer.scheme, scene.colors.nodes[scene.schemes.skeleton].title],
    ]) if (scheme) showLegend(this.part(`legend-${name}`), title, scheme.legend);
  }

  setClip() {
    const { box, scene, data } = this, axis = box.querySelector("[name=clip-axis]").value;
    const share = Number(box.querySelector("[name=clip-share]").value), back = box.querySelector("[name=clip-back]").checked;
    const k = "xyz".indexOf(axis);
    scene.clip = null;
    if (axis) {
      const at = data.box.low[k] + share * (data.box.high[k] - data.box.low[k]), sign = back ? -1 : 1;
      scene.clip = [0, 1, 2].map((i) => (i === k ? sign : 0)).concat(sign * at);
    }
    scene.redraw();
  }

  choose(tool) {
    this.tool = tool;
    this.box.querySelector(`[name=tool][value=${tool}]`).checked = true;
    this.box.dataset.tool = tool;
    this.measured = [];
    this.editor?.setFirst(null);
    this.scene.marks = [];
    this.say(tool === "measure" ? "click two places" : "");
    this.scene.redraw();
  }

  say(text) { this.part("status").textContent = text; }

  reset() { this.scene.camera.reset(); this.scene.redraw(); }

  full() { document.fullscreenElement ? document.exitFullscreen() : this.box.requestFullscreen(); }

  async share() {
    this.remember();
    try { await navigator.clipboard.writeText(location.href); this.say("address copied"); } catch { this.say("the address bar has this view"); }
  }

  // ---- clicks and keys --------------------------------------------------------------------------
  click(x, y) {
    const { scene, data } = this;
    scene.canvas.focus({ preventScroll: true });
    if (this.tool === "measure") return this.measure(pickPlace(scene, x, y));
    const hit = pickWood(scene, x, y);
    if (this.tool === "edit") return this.editor.click(hit, x, y);
    const camera = pickCamera(scene, x, y);
    if (camera) return openPhoto(this.part("photo"), scene, camera);
    if (hit) { this.cursor = hit.node; this.pickBranch(data.skeleton.axis[hit.node]); } else this.pickBranch(null);
  }

  key(e) {
    const { editor } = this, isEditing = this.tool === "edit";
    if (e.ctrlKey || e.metaKey) {
      const act = { z: e.shiftKey ? "redo" : "undo", Z: "redo", y: "redo" }[e.key];
      if (!act || !editor) return;
      editor[act]();
    } else if (e.key === "Escape") { this.choose("look"); this.pickBranch(null); }
    else if (e.key === "n" || e.key === "p") this.nextBranch(e.key === "n" ? 1 : -1);
    else if (e.key === "[" || e.key === "]") this.stepNode(e.key === "]" ? 1 : -1);
    else if (e.key === "Enter" && this.cursor != null) this.useCursor();
    else if (e.key === "m") this.choose("measure");
    else if (e.key === "l") this.choose("look");
    else if (e.key === "e" && editor) this.choose("edit");
    else if (e.key === "f") this.full();
    else if (isEditing && { c: 1, x: 1, d: 1, g: 1 }[e.key]) editor.choose({ c: "connect", x: "cut", d: "delete", g: "move" }[e.key]);
    else return;
    e.preventDefault();
  }

  // Without a mouse: the cursor is a node of the picked branch.
  nextBranch(step) {
    const { skeleton } = this.data;
    const id = this.table ? this.table.beside(this.branch, step) : ((this.branch ?? -step) + step + skeleton.branches.length) % skeleton.branches.length;
    this.pickBranch(id, { fly: true });
    this.setCursor(skeleton.axis.indexOf(id));
  }

  stepNode(step) {
    const { skeleton } = this.data, nodes = [...skeleton.axis.keys()].filter((i) => skeleton.axis[i] === this.branch);
    const at = nodes.indexOf(this.cursor) + step;
    if (nodes[at] !== undefined) this.setCursor(nodes[at]);
  }

  setCursor(node) {
    this.cursor = node;
    this.scene.marks = [{ at: place(this.data.skeleton.points, node), color: [0, 140, 255] }];
    this.scene.redraw();
  }

  useCursor() {
    if (this.tool === "edit") this.editor.use(this.cursor);
    else if (this.tool === "measure") this.measure(place(this.data.skeleton.points, this.cursor));
  }

  // ---- branches ---------------------------------------------------------------------------------
  pickBranch(id, { fly = false } = {}) {
    const { scene } = this, { skeleton } = this.data, branch = skeleton.branches[id], panel = this.part("branch");
    this.branch = branch ? id : null;
    scene.picked = this.branch; // its number
    for (const table of this.tables) table.mark(this.branch);
    panel.hidden = !branch;
    if (branch) {
      this.part("branch-name").textContent = `Branch ${id}`;
      this.part("branch-facts").replaceChildren(...[...branch.facts, ...this.age()].flatMap(([name, text]) => {
        const term = document.createElement("dt"), fact = document.createElement("dd");
        term.textContent = name;
        fact.textContent = text;
        return [term, fact];
      }));
      document.dispatchEvent(new Event("cellschange")); // they may be wanted in other units
    }
    if (branch && fly) {
      const nodes = [...skeleton.axis.keys()].filter((i) => skeleton.axis[i] === id);
      if (nodes.length) scene.flyTo(nodes.map((node) => place(skeleton.points, node)));
    }
    scene.redraw();
  }

  // How old what is measured is by now.
  age() {
    const { date } = this.data, days = Math.floor((Date.now() - Date.parse(date)) / 864e5);
    return date && Number.isFinite(days) ? [["measured on", `${date}, ${days} days ago`]] : [];
  }

  // ---- measuring --------------------------------------------------------------------------------
  measure(at) {
    if (!at) return this.say("nothing there to measure from");
    this.measured = this.measured.length === 2 ? [at] : [...this.measured, at];
    const [from, to] = this.measured;
    this.scene.marks = this.measured.map((each) => ({ at: each }));
    if (to) {
      this.scene.marks.push({ from, to });
      const [x, y, z] = to.map((v, k) => v - from[k]);
      this.say(`distance ${number(Math.hypot(x, y, z), 4)} ${this.data.unit}, level ${number(Math.hypot(x, y), 4)}, up ${number(z, 4)}`);
    } else this.say("click the second place");
    this.scene.redraw();
  }

  placeLabel() {
    const label = this.part("label"), [from, to] = this.measured, { scene, data } = this;
    const at = to && scene.onCanvas(from.map((v, k) => (v + to[k]) / 2));
    label.hidden = !at;
    if (!at) return;
    label.textContent = `${number(Math.hypot(...to.map((v, k) => v - from[k])), 4)} ${data.unit}`;
    label.style.transform = `translate(${at[0]}px, ${at[1]}px)`;
  }

  // ---- the page's address -----------------------------------------------------------------------
  rememberSoon() {
    clearTimeout(this.remembering);
    this.remembering = setTimeout(() => this.remember(), HASH_MS);
  }

  remember() {
    const { scene, box } = this, { show, schemes } = scene;
    const clip = ["axis", "share"].map((name) => box.querySelector(`[name=clip-${name}]`).value);
    this.hash = writeHash({
      ...readHash(location.hash), // what else the page holds there
      view: scene.camera.state().map((v) => Number(v.toFixed(4))).join(","),
      points: schemes.points,
      skeleton: schemes.skeleton,
      show: Object.keys(show).filter((name) => show[name]).join(","),
      hidden: [...scene.hidden].join(","),
      clip: scene.clip ? [...clip, Number(box.querySelector("[name=clip-back]").checked)].join(",") : "",
      branch: this.branch,
      draw: scene.wish,
    });
    if (location.hash !== this.hash) history.replaceState(null, "", this.hash);
  }

  restore() {
    const { scene, box } = this, held = readHash(location.hash);
    const list = (text) => (text || "").split(",").filter((each) => each !== "");
    if (held.view) scene.camera.set(list(held.view).map(Number));
    for (const name of ["points", "skeleton"]) {
      const known = name === "points" ? scene.colors.points : scene.colors.nodes;
      if (Object.hasOwn(known, held[name] || "")) scene.schemes[name] = held[name];
      box.querySelector(`select[name=${name}]`).value = scene.schemes[name];
    }
    if (held.show !== undefined) for (const name of Object.keys(scene.show)) scene.show[name] = list(held.show).includes(name);
    for (const name of Object.keys(scene.show)) box.querySelector(`[name=show-${name}]`).checked = scene.show[name];
    scene.hidden = new Set(list(held.hidden).map(Number));
    for (const check of box.querySelectorAll("[name=class]")) check.checked = !scene.hidden.has(Number(check.value));
    if (held.clip) {
      const [axis, share, back] = list(held.clip);
      box.querySelector("[name=clip-axis]").value = ["x", "y", "z"].includes(axis) ? axis : "";
      box.querySelector("[name=clip-share]").value = share;
      box.querySelector("[name=clip-back]").checked = back === "1";
    }
    this.setClip();
    this.recolor();
    this.pickBranch(/^\d+$/.test(held.branch || "") ? Number(held.branch) : null);
  }
}

function checkBox(name, value, title, color) {
  const label = document.createElement("label"), check = document.createElement("input"), chip = document.createElement("span");
  Object.assign(check, { type: "checkbox", name, value, checked: true });
  chip.className = "chip";
  chip.style.background = css(color);
  label.append(check, chip, title);
  return label;
}
