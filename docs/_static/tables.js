// Tables with at least four columns can be sorted by a click on a heading, or by Enter on it. The key is the first number
// of each cell if most cells have one, otherwise the text.
"use strict";

const NUMBER = /^[^\d-]{0,3}(-?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?)/;

function number(cell) {
  const found = cell.textContent.trim().match(NUMBER);
  return found ? Number(found[1].replaceAll(",", "")) : NaN;
}

function sort(table, heading, column) {
  const descending = heading.ariaSort === "ascending";
  for (const other of table.tHead.rows[0].cells) other.removeAttribute("aria-sort");
  heading.ariaSort = descending ? "descending" : "ascending";
  const body = table.tBodies[0];
  const rows = [...body.rows].map((row) => ({ row, text: row.cells[column].textContent, value: number(row.cells[column]) }));
  const numeric = rows.filter(({ value }) => !Number.isNaN(value)).length > rows.length / 2;
  rows.sort((a, b) => {
    if (numeric && Number.isNaN(a.value) !== Number.isNaN(b.value)) return Number.isNaN(a.value) ? 1 : -1; // at the end
    const order = numeric ? a.value - b.value || 0 : a.text.localeCompare(b.text);
    return descending ? -order : order;
  });
  body.append(...rows.map(({ row }) => row));
}

addEventListener("DOMContentLoaded", () => {
  for (const table of document.querySelectorAll("article table.docutils")) {
    const headings = table.tHead ? [...table.tHead.rows[0].cells] : [];
    if (headings.length < 4 || table.tBodies[0].rows.length < 4) continue;
    table.classList.add("sortable");
    headings.forEach((heading, column) => {
      heading.tabIndex = 0;
      heading.addEventListener("click", () => sort(table, heading, column));
      heading.addEventListener("keydown", (event) => event.key === "Enter" && sort(table, heading, column));
    });
  }
});
