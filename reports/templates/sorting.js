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
