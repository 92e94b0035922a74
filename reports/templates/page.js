"use strict";
// Sort a table by the column whose head is chosen: first the better way round, then the other. Gaps stay last, and
// published rows below all others: their values are not comparable.
const said = document.getElementById("said");
for (const table of document.querySelectorAll("table.sortable")) {
  const body = table.tBodies[0];
  const heads = [...table.querySelectorAll("th[data-sort]")];
  heads.forEach((head, index) => {
    const button = document.createElement("button");
    button.type = "button";
    button.append(...head.childNodes);
    head.append(button);
    button.addEventListener("click", () => {
      const first = head.dataset.sort === "high" ? "descending" : "ascending";
      const order = head.getAttribute("aria-sort") !== first ? first : first === "ascending" ? "descending" : "ascending";
      heads.forEach((other) => other.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", order);
      said.textContent = `Sorted by ${button.textContent.trim()}, ${order}`;
      const sign = order === "ascending" ? 1 : -1;
      const value = (row) => row.cells[index].dataset.value;
      const published = (row) => Number(row.classList.contains("published"));
      const compare = (a, b) => {
        if (a === "" || b === "") return (a === "") - (b === "");
        return sign * (head.dataset.sort === "text" ? a.localeCompare(b) : Number(a) - Number(b));
      };
      body.append(...[...body.rows].sort((a, b) => published(a) - published(b) || compare(value(a), value(b))));
    });
  });
}
// Show one group of columns at a time; on a narrow screen the first one to begin with.
const picker = document.querySelector(".picker");
const buttons = [...picker.querySelectorAll("button")];
function pick(group) {
  for (const button of buttons) button.setAttribute("aria-pressed", String(button.dataset.group === group));
  for (const cell of document.querySelectorAll(".results [data-group]")) cell.hidden = group !== "" && cell.dataset.group !== group;
}
for (const button of buttons) button.addEventListener("click", () => pick(button.dataset.group));
picker.hidden = buttons.length < 3;
if (!picker.hidden && matchMedia("(max-width: 40rem)").matches) pick(buttons[1].dataset.group);
// Of the figures that a group of choices is for, show those that agree with every pressed button.
for (const choices of document.querySelectorAll(".choices")) {
  const figures = [...document.getElementById(choices.dataset.for).children];
  function apply() {
    const pressed = [...choices.querySelectorAll('[aria-pressed="true"]')].flatMap((button) => Object.entries(button.dataset));
    for (const figure of figures) figure.hidden = !pressed.every(([name, value]) => figure.dataset[name] === value);
  }
  for (const group of choices.querySelectorAll('[role="group"]')) {
    group.addEventListener("click", ({ target }) => {
      if (target.tagName !== "BUTTON") return;
      for (const button of group.children) button.setAttribute("aria-pressed", String(button === target));
      apply();
    });
  }
  choices.hidden = false;
  apply();
}
// Print shows everything.
addEventListener("beforeprint", () => pick(""));
