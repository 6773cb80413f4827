'use strict';
// Charts of uPlot: each with a legend that reads what is under the cursor; a drag zooms, a double click shows all again.
const chartStyle = () => {
  const style = getComputedStyle(document.documentElement);
  return {text: style.getPropertyValue('--dim').trim() || '#57606a', grid: style.getPropertyValue('--line').trim() || '#e4e8ec'};
};

// named: the unit stands at the axis, where no heading has it
function chartOptions(width, height, unit, series, {log, key, frequency, band, hooks, named}) {
  const {text, grid} = chartStyle();
  const axis = {stroke: text, grid: {stroke: grid, width: 1}, ticks: {stroke: grid, width: 1}, font: '12px system-ui'};
  const read = (u, v) => v == null ? '–' : +v.toPrecision(3) + ' ' + unit;
  return {
    width, height, hooks: hooks || {},
    cursor: {sync: key ? {key, setSeries: false} : undefined, drag: {x: true, y: false}, points: {size: 6}},
    scales: {x: {time: false, distr: frequency ? 3 : 1}, y: {distr: log ? 3 : 1}},
    axes: [{...axis, values: (u, all) => all.map(v => v == null ? '' : v + (frequency ? ' Hz' : ' s')), space: 70},
           {...axis, size: 64, values: (u, all) => all.map(v => v == null ? '' : +v.toPrecision(3) + (named ? ' ' + unit : ''))}],
    bands: band && band.length ? [{series: band, fill: grid + '88'}] : [],
    series: [{label: frequency ? 'frequency' : 'time', value: (u, v) => v == null ? '–' : +v.toPrecision(6) + (frequency ? ' Hz' : ' s')},
      ...series.map(l => ({label: l.name, stroke: l.colour, width: l.dots ? 0 : l.width, dash: l.dash, value: read,
                           spanGaps: false, show: l.shown !== false,
                           points: l.dots ? {show: true, size: 4, fill: l.colour, width: 0} : {show: false}}))],
  };
}

// a logarithmic axis has no place for what is not above zero
const drawable = (ys, log) => ys.map(y => log ? y.map(v => v !== null && v > 0 ? v : null) : y);

document.querySelectorAll('.charts').forEach(function (root, number) {
  const all = JSON.parse(root.querySelector('script[type="application/json"]').textContent);
  const place = root.querySelector('.plots'), key = 'time' + number;
  let made = null;

  function make() {
    made = all.map(function (chart) {
      const figure = document.createElement('figure'), caption = document.createElement('figcaption');
      const button = document.createElement('button'), box = document.createElement('div');
      caption.textContent = chart.title + (chart.unit ? ', ' + chart.unit + ' ' : ' ');
      button.type = 'button';
      button.hidden = chart.lines.some(l => l.y.some(v => v < 0));
      caption.append(button);
      figure.append(caption, box);
      place.append(figure);
      let plot = null;
      function draw() {
        if (plot) plot.destroy();
        button.textContent = chart.log ? 'linear' : 'logarithmic';
        plot = new uPlot(chartOptions(root.clientWidth, root.clientWidth < 600 ? 190 : 220, chart.unit, chart.lines,
          {log: chart.log, key: chart.frequency ? undefined : key, frequency: chart.frequency, band: chart.band}),
          [chart.x, ...drawable(chart.lines.map(l => l.y), chart.log)], box);
      }
      button.onclick = () => { chart.log = !chart.log; draw(); };
      draw();
      return () => plot.setSize({width: root.clientWidth, height: root.clientWidth < 600 ? 190 : 220});
    });
  }

  // what is folded away has no width until it is opened
  let width = 0;
  new ResizeObserver(function () {
    if (root.clientWidth === width || !root.clientWidth) return;
    width = root.clientWidth;
    if (made) made.forEach(resize => resize()); else make();
  }).observe(root);
});
