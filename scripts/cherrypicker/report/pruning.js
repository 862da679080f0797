// Other limits, and cuts that shall not be made, as the lines of config that plan the pruning anew.
"use strict";
(() => {
  const box = document.getElementById("replan");
  if (!box) return;
  const held = JSON.parse(box.dataset.keep), keep = new Set(held), limits = new Map();

  // A column more of a table, in which each row that has something to ask gets an input.
  function ask(table, head, inputOf) {
    table.tHead.rows[0].append(Object.assign(document.createElement("th"), { textContent: head, className: "screen" }));
    for (const row of table.tBodies[0].rows) {
      const cell = row.insertCell(), input = inputOf(row);
      cell.className = "screen";
      cell.dataset.value = 0; // to sort by
      if (!input) continue;
      cell.append(input);
      for (const event of ["click", "keydown"]) cell.addEventListener(event, (e) => e.stopPropagation());
      input.addEventListener("input", () => { cell.dataset.value = Number(input.checked); tell(); });
    }
  }

  ask(document.getElementById("targets"), "rather", (row) => {
    const { name, limit } = row.dataset;
    if (!name) return null;
    const input = Object.assign(document.createElement("input"), { type: "number", min: 0, step: "any", placeholder: limit, size: 6 });
    input.setAttribute("aria-label", `another limit of: ${row.cells[0].textContent}`);
    input.addEventListener("input", () => { if (input.value === "" || !input.checkValidity()) limits.delete(name); else limits.set(name, input.value); });
    return input;
  });
  const cuts = document.getElementById("pruning");
  if (cuts) ask(cuts, "keep", (row) => {
    const axis = Number(row.dataset.branch), input = Object.assign(document.createElement("input"), { type: "checkbox" });
    input.setAttribute("aria-label", `do not cut axis ${axis}`);
    input.addEventListener("input", () => {
      keep[input.checked ? "add" : "delete"](axis);
      for (const other of cuts.tBodies[0].rows)
        if (other.dataset.branch === row.dataset.branch) other.cells[other.cells.length - 1].firstChild.checked = input.checked;
    });
    return input;
  });

  function tell() {
    const lines = ["pruning:"];
    if (limits.size) lines.push(`  target: {${[...limits].map((each) => each.join(": ")).join(", ")}}`);
    if (keep.size !== held.length) lines.push(`  keep: [${[...keep].sort((a, b) => a - b).join(", ")}]`);
    box.hidden = lines.length === 1;
    box.querySelector("pre").textContent = lines.join("\n");
  }
})();
