// A button over each `table[data-copy]` that copies what it shows, tab by tab, for a spreadsheet.
"use strict";
(() => {
  async function copy(text) {
    try {
      await navigator.clipboard.writeText(text);
    } catch { // pages opened as files, in some browsers
      const area = document.createElement("textarea");
      area.value = text;
      document.body.append(area);
      area.select();
      document.execCommand("copy");
      area.remove();
    }
  }

  for (const table of document.querySelectorAll("table[data-copy]")) {
    const button = document.createElement("button");
    Object.assign(button, { type: "button", className: "copy screen", textContent: "copy table" });
    button.addEventListener("click", async () => {
      const rows = [...table.rows].filter((row) => row.offsetParent);
      await copy(rows.map((row) => [...row.cells].filter((cell) => cell.offsetParent)
        .map((cell) => cell.innerText.trim().replace(/\s+/g, " ")).join("\t")).join("\n"));
      button.textContent = "copied";
      setTimeout(() => { button.textContent = "copy table"; }, 2000);
    });
    table.parentElement.before(button);
  }
})();
