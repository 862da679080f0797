// A table of branches: sorted by a click on a head, its rows bound to the branches of the scene.

export class BranchTable {
  // onPick(branch_id) is called when a row is clicked, or Enter is pressed on it.
  constructor(table, onPick) {
    this.table = table;
    this.body = table.tBodies[0];
    this.rows = new Map([...this.body.rows].map((row) => [Number(row.dataset.branch), row]));
    [...table.tHead.rows[0].cells].forEach((head, column) => {
      const button = document.createElement("button");
      button.type = "button";
      button.append(...head.childNodes);
      head.append(button);
      button.addEventListener("click", () => this.sort(column));
    });
    for (const [id, row] of this.rows) {
      row.tabIndex = 0;
      row.addEventListener("click", () => onPick(id));
      row.addEventListener("keydown", (e) => {
        if (e.key === "Enter") onPick(id);
        const step = { ArrowDown: row.nextElementSibling, ArrowUp: row.previousElementSibling }[e.key];
        if (step) { step.focus(); e.preventDefault(); }
      });
    }
  }

  sort(column) {
    const heads = [...this.table.tHead.rows[0].cells];
    const down = heads[column].ariaSort === "ascending";
    for (const head of heads) head.removeAttribute("aria-sort");
    heads[column].ariaSort = down ? "descending" : "ascending";
    const key = (row) => row.cells[column].dataset.value;
    const isNumber = heads[column].dataset.kind !== "text";
    const compare = (a, b) => (isNumber ? Number(a) - Number(b) : a.localeCompare(b));
    const rows = [...this.body.rows].sort((a, b) => {
      const [left, right] = [key(a), key(b)];
      if (left === "" || right === "") return (left === "") - (right === ""); // no number: last
      return down ? compare(right, left) : compare(left, right);
    });
    this.body.append(...rows);
  }

  mark(id) {
    for (const [branch, row] of this.rows) row.classList.toggle("picked", branch === id);
    const row = this.rows.get(id), box = this.table.parentElement;
    if (row) box.scrollTop = row.offsetTop - box.clientHeight / 2; // without moving the page
  }

  // The branch before or after one, in the order of the rows.
  beside(id, step) {
    const ids = [...this.body.rows].map((row) => Number(row.dataset.branch)), at = ids.indexOf(id);
    return ids[at < 0 ? 0 : (at + step + ids.length) % ids.length];
  }
}
