'use strict';
// The table of recordings: search, sort by a click on a heading, so many rows at a time. No library, no network.
document.querySelectorAll('.fleet-table').forEach(function (root) {
  const {columns, rows} = JSON.parse(root.querySelector('script[type="application/json"]').textContent);
  const head = root.querySelector('thead'), body = root.querySelector('tbody'), said = root.querySelector('.said');
  const search = root.querySelector('input'), size = 50;
  const texts = rows.map(row => row.join(' ').toLowerCase());
  let order = rows.map((_, i) => i), by = null, down = false, first = 0, found = order;

  const line = document.createElement('tr');
  columns.forEach(function (name, column) {
    const cell = document.createElement('th');
    cell.textContent = name;
    cell.scope = 'col';
    cell.style.cursor = 'pointer';
    cell.onclick = function () {
      down = by === column && !down;
      by = column;
      order.sort((a, b) => compare(rows[a][column], rows[b][column]) * (down ? -1 : 1) || a - b);
      select();
    };
    line.append(cell);
  });
  head.append(line);

  function compare(a, b) {  // what is not known comes last
    if (a === b) return 0;
    if (a === null || a === '') return 1;
    if (b === null || b === '') return -1;
    return a < b ? -1 : 1;
  }

  function select() {
    const words = search.value.toLowerCase().split(/\s+/).filter(Boolean);
    found = order.filter(i => words.every(word => texts[i].includes(word)));
    first = 0;
    show();
  }

  function show() {
    const shown = found.slice(first, first + size);
    body.replaceChildren(...shown.map(function (i) {
      const row = document.createElement('tr'), page = rows[i][columns.length];
      columns.forEach(function (name, column) {
        const cell = document.createElement('td'), value = rows[i][column];
        cell.dataset.label = name;
        if (typeof value === 'number') cell.className = 'number';
        if (name === 'recording' && page) {
          const link = document.createElement('a');
          link.href = page;
          link.textContent = value;
          cell.append(link);
        } else cell.textContent = value === null ? '\u2013' : value;
        row.append(cell);
      });
      return row;
    }));
    said.textContent = found.length ? (first + 1) + ' to ' + (first + shown.length) + ' of ' + found.length : 'none';
    root.querySelectorAll('button').forEach(function (button) {
      const to = first + size * button.dataset.turn;
      button.disabled = to < 0 || to >= found.length;
    });
  }

  root.querySelectorAll('button').forEach(function (button) {
    button.onclick = () => { first += size * button.dataset.turn; show(); };
  });
  search.oninput = select;
  select();
});
