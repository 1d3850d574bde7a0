"use strict";
// Functions of every page: unpack its data and the library of charts, sort tables, show one of several panels.

document.documentElement.classList.add("js");

/** Return the decompressed text of an element. */
async function unpacked(id) {
  const text = document.getElementById(id).textContent.trim();
  const bytes = Uint8Array.from(atob(text), (c) => c.charCodeAt(0));
  return new Response(new Blob([bytes]).stream().pipeThrough(new DecompressionStream("gzip"))).text();
}

/** Load the library of charts and return the data of the page. */
async function loaded() {
  const [code, data] = await Promise.all([unpacked("library"), unpacked("data")]);
  const script = document.createElement("script");
  script.textContent = `(() => {${code}})();`; // keeps its names out of the global scope
  document.head.append(script);
  return JSON.parse(data);
}

/** Call a function that draws the charts with the data of the page; show a message if this fails. */
function shown(draw) {
  loaded().then(draw).catch((error) => {
    const note = document.createElement("p");
    note.className = "failed";
    note.textContent = `The charts cannot be drawn here: ${error.message}. The tables have all numbers.`;
    document.querySelector("main").prepend(note);
    throw error;
  });
}

const FONT = "system-ui, -apple-system, 'Segoe UI', sans-serif";
const CONFIG = {
  font: FONT,
  background: "transparent",
  view: { stroke: null },
  axis: { labelColor: "#1d2733", titleColor: "#1d2733", titleFontWeight: 500, gridColor: "#e6e9ed", domainColor: "#9aa4af", tickColor: "#9aa4af", labelFontSize: 11, titleFontSize: 12 },
};

/** Draw a chart into an element and return its view. */
async function drawn(element, spec) {
  const options = { renderer: "svg", actions: { export: true, source: false, compiled: false, editor: false } };
  const name = (document.title + "-" + element.id).replace(/[^\w-]+/g, "-");
  const autosize = { type: "fit-x", contains: "padding" };
  const { view } = await window.vegaEmbed(element, { ...spec, config: CONFIG, autosize }, { ...options, downloadFileName: name });
  return view;
}

/** Sort a table by a click on a heading; cells without a value are last. */
function sortable(table) {
  const headings = [...table.tHead.rows[0].cells];
  const key = (row, i) => row.cells[i].dataset.key ?? row.cells[i].textContent;
  headings.forEach((heading, i) => {
    if (heading.classList.contains("plain") || heading.dataset.scenario) return;
    heading.setAttribute("aria-sort", "none");
    heading.tabIndex = 0;
    const sort = () => {
      const up = heading.getAttribute("aria-sort") === "none" ? heading.classList.contains("name") || !/score|capped/.test(heading.textContent) : heading.getAttribute("aria-sort") !== "ascending";
      headings.forEach((other) => other.hasAttribute("aria-sort") && other.setAttribute("aria-sort", "none"));
      heading.setAttribute("aria-sort", up ? "ascending" : "descending");
      const rows = [...table.tBodies[0].rows];
      const numbers = rows.every((row) => key(row, i) === "" || !Number.isNaN(Number(key(row, i))));
      rows.sort((a, b) => {
        const [x, y] = [key(a, i), key(b, i)];
        if (x === "" || y === "") return (x === "") - (y === "");
        return (numbers ? x - y : String(x).localeCompare(String(y))) * (up ? 1 : -1);
      });
      table.tBodies[0].append(...rows);
    };
    heading.addEventListener("click", sort);
    heading.addEventListener("keydown", (event) => event.key === "Enter" && sort());
  });
}

/** Show the panel with an index, and hide the other panels of the name. */
function turned(name, index) {
  const holder = document.querySelector(`[data-panels="${name}"]`);
  if (!holder) return;
  holder.classList.add("single");
  for (const panel of holder.children) panel.classList.toggle("current", panel.dataset.panel === String(index));
  for (const tab of document.querySelectorAll(`[data-for="${name}"] [data-tab]`)) tab.setAttribute("aria-selected", String(tab.dataset.tab === String(index)));
}

document.querySelectorAll("table.sortable").forEach(sortable);
for (const tabs of document.querySelectorAll("[data-for]")) {
  tabs.addEventListener("click", (event) => event.target.dataset.tab !== undefined && turned(tabs.dataset.for, event.target.dataset.tab));
}
for (const holder of document.querySelectorAll("[data-panels]")) turned(holder.dataset.panels, 0);
document.documentElement.dataset.ready = "tables";
