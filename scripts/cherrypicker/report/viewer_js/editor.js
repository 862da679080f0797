// Editing by clicking: the bar of tools, undo and redo, and where the corrections are saved.
import { number } from "viewer/colors.js";
import { place } from "viewer/data.js";
import { EditedTree, nodesOf, parseLines, yamlLine } from "viewer/edits.js";
import { onPlaneOf, snapToBase } from "viewer/picking.js";
import { SOUND } from "viewer/scene.js";

const ASK = {
  connect: ["click the wood that hangs wrong, at its base", "now click where it belongs"],
  cut: ["click where the wood comes off"],
  delete: ["click the wood to delete, with all beyond it"],
  move: ["click the place to move", "now click where it belongs, in the plane of the screen"],
};

export class Editor {
  constructor(scene, bar, info) {
    Object.assign(this, { scene, bar, info, edits: [], undone: [], tool: "connect", first: null });
    this.tree = new EditedTree(scene.data.skeleton, scene.layer.state);
    this.origin = scene.data.origin;
    this.part = (name) => bar.querySelector(`[data-part=${name}]`);
    for (const button of bar.querySelectorAll("[data-tool]")) {
      button.addEventListener("click", () => this.choose(button.dataset.tool));
    }
    for (const name of ["undo", "redo", "download", "save"]) this.part(name).addEventListener("click", () => this[name]());
    this.choose("connect");
    this.update();
    this.before = this.tree.length();
    if (/^https?:$/.test(location.protocol) && info.tree) this.askServer();
  }

  say(text, isBad = false) {
    this.part("status").textContent = text;
    this.part("status").classList.toggle("bad", isBad);
  }

  choose(tool) {
    this.tool = tool;
    this.setFirst(null);
    for (const button of this.bar.querySelectorAll("[data-tool]")) {
      button.setAttribute("aria-pressed", button.dataset.tool === tool);
    }
    this.say(ASK[tool][0]);
  }

  // `hit` as of pickWood; x and y in px of the canvas.
  click(hit, x, y) {
    const { tool, first } = this;
    if (first && tool === "move") return this.moveTo(onPlaneOf(this.scene, place(this.tree.skeleton.points, first.node), x, y));
    if (!hit) return this.say("no wood there: " + ASK[tool][first ? 1 : 0], true);
    this.use(first || tool === "move" ? hit.nearest : snapToBase(this.scene, hit));
  }

  // Take a node as what the tool asks for.
  use(node) {
    const { tool, first } = this, { points } = this.tree.skeleton;
    if (ASK[tool].length === 2 && !first) {
      this.setFirst({ node });
      return this.say(ASK[tool][1]);
    }
    if (tool === "move") return this.say("click on the new place", true);
    const at = place(points, node);
    if (tool === "connect") this.add({ kind: tool, nodes: [first.node, node], places: { from: place(points, first.node), to: at } });
    else this.add({ kind: tool, nodes: [node], places: { at } });
  }

  moveTo(to) {
    const { node } = this.first;
    this.add({ kind: "move", nodes: [node], places: { from: place(this.tree.skeleton.points, node), to } });
  }

  setFirst(first) {
    this.first = first;
    this.scene.marks = first ? [{ at: place(this.tree.skeleton.points, first.node) }] : [];
    this.scene.lit = first && this.tool === "connect" ? this.tree.beyond(first.node) : null;
    this.scene.redraw();
  }

  add(edit) {
    const refusal = this.tree.refusal(edit);
    this.setFirst(null);
    if (refusal) return this.say("refused: " + refusal, true);
    this.edits.push(edit);
    this.undone = [];
    this.update(edit.kind + " done");
  }

  undo() { this.shift(this.edits, this.undone, "undone"); }
  redo() { this.shift(this.undone, this.edits, "done again"); }

  shift(from, to, said) {
    this.setFirst(null);
    if (!from.length) return this.say("nothing left to " + (from === this.edits ? "undo" : "redo"));
    to.push(from.pop());
    this.update(said);
  }

  update(said = "") {
    const { edits, tree, scene } = this;
    tree.replay(edits);
    this.part("undo").disabled = !edits.length;
    this.part("redo").disabled = !this.undone.length;
    this.part("list").replaceChildren(...edits.map((edit) => {
      const item = document.createElement("li");
      item.textContent = yamlLine(edit, this.origin, "").slice(2).trim();
      return item;
    }));
    const changed = edits.length ? `, length ${number(this.before, 4)} → ${number(tree.length(), 4)} ${scene.data.unit}` : "";
    const isLoose = tree.state.some((state, node) => state !== SOUND && tree.alive[node] && tree.skeleton.parent[node] === -1 && node > 0);
    this.part("sum").textContent = `${edits.length} correction${edits.length === 1 ? "" : "s"}${changed}`
      + (isLoose ? "; grey wood is off unless it is connected" : "");
    this.say(said || ASK[this.tool][0]);
    scene.redraw();
  }

  // The file with these corrections after those that it held.
  yaml() {
    const { text, indent, n } = this.info;
    if (!this.edits.length && !n) return "edits: []\n";
    return text + this.edits.map((edit) => yamlLine(edit, this.origin, indent)).join("");
  }

  download() {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(new Blob([this.yaml()], { type: "text/yaml" }));
    link.download = this.info.name;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    this.say(`saved as ${this.info.name}: put it into config/edits/ and run again`);
  }

  get address() { return "/api/edits/" + encodeURIComponent(this.info.tree); }

  // What the server holds: the corrections of the last run, or some that were saved since.
  async askServer() {
    try {
      const answer = await fetch(this.address);
      if (answer.status !== 200 && answer.status !== 204) return;
      const held = answer.status === 204 ? "" : (await answer.text()).trimEnd() + "\n";
      const { raw, text } = this.info, isAsRun = held === raw || (!raw && held === "edits: []\n");
      const added = isAsRun ? [] : held.startsWith(text) && parseLines(held.slice(text.length), this.origin);
      if (!added) return this.say("the server's corrections have changed since this page was made: run again to edit them", true);
      for (const edit of added) {
        this.tree.replay(this.edits);
        this.edits.push({ ...edit, nodes: nodesOf(edit, this.tree) });
      }
      this.part("save").hidden = false;
      this.update(added.length ? "with the corrections that were saved before" : "");
    } catch (error) { console.info("no server of corrections:", error.message); }
  }

  async save() {
    try {
      const headers = { "Content-Type": "text/yaml", "X-CherryPicker": "edit" };
      const answer = await fetch(this.address, { method: "PUT", headers, body: this.yaml() });
      const said = await answer.json();
      if (!answer.ok) return this.say("not saved: " + said.error, true);
      this.say(`saved as ${said.path}: the next run applies it`);
    } catch (error) { this.say("not saved: " + error.message, true); }
  }
}
