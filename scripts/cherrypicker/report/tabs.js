// Sections that share a row of tabs: each `section[data-tab]`; paper shows all of them.
"use strict";
(() => {
  const panels = [...document.querySelectorAll("section[data-tab]")];
  if (panels.length < 2) return;
  const bar = document.createElement("div");
  bar.className = "tabs screen";
  bar.setAttribute("role", "tablist");
  bar.setAttribute("aria-label", "What to decide from");
  const tabs = panels.map((panel, place) => {
    const tab = document.createElement("button");
    Object.assign(tab, { type: "button", id: `tab-${panel.id}`, textContent: panel.dataset.tab });
    tab.setAttribute("role", "tab");
    tab.setAttribute("aria-controls", panel.id);
    panel.setAttribute("role", "tabpanel");
    panel.setAttribute("aria-labelledby", tab.id);
    tab.addEventListener("click", () => { choose(place); remember(panel); color(panel); });
    tab.addEventListener("keydown", ({ key }) => {
      const to = { ArrowRight: place + 1, ArrowLeft: place - 1, Home: 0, End: -1 }[key];
      if (to === undefined) return;
      const next = tabs[(to + tabs.length) % tabs.length];
      next.focus();
      next.click();
    });
    return tab;
  });
  bar.append(...tabs);
  panels[0].before(bar);

  function choose(chosen) {
    tabs.forEach((tab, place) => {
      tab.setAttribute("aria-selected", place === chosen);
      tab.tabIndex = place === chosen ? 0 : -1;
      panels[place].classList.toggle("behind", place !== chosen);
    });
  }

  // The address holds the tab beside the view.
  function remember(panel) {
    const held = new URLSearchParams(location.hash.slice(1));
    held.set("tab", panel.id);
    history.replaceState(null, "", `#${held}`.replace(/%2C/g, ","));
  }

  // The skeleton takes the colour that the tab speaks of.
  function color(panel) {
    const select = document.querySelector(".viewer select[name=skeleton]");
    if (![...(select?.options ?? [])].some(({ value }) => value === panel.dataset.color)) return;
    select.value = panel.dataset.color;
    select.dispatchEvent(new Event("input", { bubbles: true }));
  }

  const restore = () => {
    const held = new URLSearchParams(location.hash.slice(1)).get("tab");
    choose(Math.max(0, panels.findIndex(({ id }) => id === held)));
  };
  window.addEventListener("hashchange", restore);
  restore();
})();
