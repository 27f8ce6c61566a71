// Tables that sort by the columns whose headings are buttons, and a field that shows only the rows that hold its text.
"use strict";

(() => {
  const text = (row, column) => row.cells[column].textContent.trim();

  function compare(a, b) {
    const [x, y] = [parseFloat(a), parseFloat(b)];
    const numbers = /^[-+\d.\s±]+$/.test(a) && /^[-+\d.\s±]+$/.test(b);
    return numbers ? x - y : a.localeCompare(b, undefined, { numeric: true });
  }

  function sort(table, heading) {
    const descending = heading.getAttribute("aria-sort") === "ascending";
    for (const other of table.tHead.rows[0].cells) if (other.hasAttribute("aria-sort")) other.setAttribute("aria-sort", "none");
    heading.setAttribute("aria-sort", descending ? "descending" : "ascending");
    const column = heading.cellIndex;
    const rows = [...table.tBodies[0].rows].sort((a, b) => {
      const [x, y] = [text(a, column), text(b, column)];
      if (!x || !y) return !x - !y; // what is empty stays below
      return descending ? compare(y, x) : compare(x, y);
    });
    table.tBodies[0].append(...rows);
  }

  function filter(field) {
    const rows = [...document.getElementById(field.dataset.filter).tBodies[0].rows];
    const wanted = field.value.trim().toLowerCase();
    for (const row of rows) row.hidden = !row.textContent.toLowerCase().includes(wanted);
    const shown = rows.filter((row) => !row.hidden).length;
    document.querySelector(`[data-count="${field.dataset.filter}"]`).textContent = wanted ? `${shown} of ${rows.length}` : "";
  }

  for (const table of document.querySelectorAll("table.sortable"))
    for (const button of table.tHead.querySelectorAll("button"))
      button.addEventListener("click", () => sort(table, button.closest("th")));
  for (const field of document.querySelectorAll("input[data-filter]")) {
    field.addEventListener("input", () => filter(field));
    field.form.addEventListener("submit", (event) => event.preventDefault());
  }
})();
