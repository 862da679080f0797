// Feet and inches in place of metres, in tables and in what is said of a branch, where `#units` asks for them.
"use strict";
(() => {
  const choice = document.getElementById("units"), KEY = "cherrypicker-units";
  if (!choice) return;
  const US = { m: [3.28084, "ft"], mm: [0.0393701, "in"], "cm²": [0.155, "in²"], "m²": [10.7639, "ft²"], "dm³": [0.0353147, "ft³"], "m³": [35.3147, "ft³"] };
  const THIN = { m: [39.3701, "in"] }; // diameters are told in inches
  const UNIT = "mm|cm²|m²|dm³|m³|m";
  const told = new WeakMap(); // of each cell and head: its metric text, and what is shown for it
  const NUMBER = /-?\d[\d,]*(?:\.\d+)?/g;

  function metric(node) {
    const known = told.get(node);
    if (known && known.shown === node.textContent) return known.metric;
    told.set(node, { metric: node.textContent, shown: node.textContent });
    return node.textContent;
  }

  function show(node, text) {
    const held = { metric: metric(node), shown: text };
    if (node.textContent !== text) (node.querySelector("button") ?? node).textContent = text;
    told.set(node, held);
  }

  // What a unit's numbers are multiplied by, and its name then; `isDense` are numbers per cm².
  function conversion(unit, isDense, name) {
    const isThin = /diameter/i.test(name) && !/height/i.test(name);
    const [factor, word] = (isThin && THIN[unit]) || US[unit] || [1, unit];
    return { factor: isDense ? factor / US["cm²"][0] : factor, word };
  }

  function scaled(text, factor) {
    return text.replace(NUMBER, (number) => {
      const decimals = (number.split(".")[1] ?? "").length, value = factor * Number(number.replace(/,/g, ""));
      const kept = Math.max(0, decimals - Math.floor(Math.log10(factor)));
      return value.toLocaleString("en", { minimumFractionDigits: kept, maximumFractionDigits: kept, useGrouping: number.includes(",") || value >= 1e4 });
    });
  }

  // The unit that stands behind a text's first number.
  const unitIn = (text) => text.match(new RegExp(`\\d\\)? (${UNIT})(?![\\w²³])`))?.[1];

  function convert(node, name, unit, isDense, isUS) {
    const text = metric(node), { factor, word } = conversion(unit, isDense, name);
    const isKept = !isUS || factor === 1 || !/\d/.test(text);
    show(node, isKept ? text : scaled(text, factor).replace(new RegExp(`(\\d\\)?) ${unit}(?![\\w²³])`), `$1 ${word}`));
  }

  function apply() {
    const isUS = choice.value === "us";
    for (const table of document.querySelectorAll("table")) {
      const heads = [...(table.tHead?.rows[0]?.cells ?? [])].map((head) => ({ head, text: metric(head) }));
      const columns = heads.map(({ head, text }) => {
        const unit = text.match(new RegExp(`\\[(${UNIT})\\]`))?.[1], isDense = / a cm²/.test(text);
        const { word } = conversion(unit, false, text);
        show(head, !isUS ? text : text.replace(`[${unit}]`, `[${word}]`).replace(" a cm²", " a in²"));
        return { unit, isDense, text };
      });
      for (const row of [...table.tBodies, ...(table.tFoot ? [table.tFoot] : [])].flatMap((part) => [...part.rows])) {
        const cells = [...row.cells], name = metric(cells[0]);
        const ofRow = cells.map((cell) => unitIn(metric(cell))).find(Boolean);
        let column = 0;
        for (const cell of cells) {
          const of = columns[column] ?? {};
          column += cell.colSpan;
          if (!cell.classList.contains("n")) continue;
          const unit = unitIn(metric(cell)) ?? of.unit ?? (of.isDense ? undefined : ofRow);
          convert(cell, `${of.text ?? ""} ${name}`, unit, of.isDense, isUS);
        }
      }
    }
    for (const fact of document.querySelectorAll(".viewer dd"))
      convert(fact, fact.previousElementSibling.textContent, unitIn(metric(fact)), false, isUS);
  }

  try { choice.value = localStorage.getItem(KEY) ?? "metric"; } catch { /* a page that may keep nothing */ }
  choice.addEventListener("change", () => {
    try { localStorage.setItem(KEY, choice.value); } catch { /* as above */ }
    apply();
  });
  document.addEventListener("cellschange", apply);
  apply();
})();
