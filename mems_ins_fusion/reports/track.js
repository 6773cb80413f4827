'use strict';
// The interactive track: a map to scale above, the error against time below (uPlot), one cursor for both. No network,
// unless a person asks for a base map and says from where.
// Data: track.py. All lengths in metres, times in seconds.
document.querySelectorAll('.track').forEach(function (root) {
  const {layers, place} = JSON.parse(root.querySelector('script[type="application/json"]').textContent);
  const map = root.querySelector('canvas.map'), strip = root.querySelector('.time');
  const said = root.querySelector('.said'), scaleText = root.querySelector('.scale'), fromText = root.querySelector('.from');
  const lines = layers.filter(l => l.error);
  const home = extent(layers.filter(l => l.shown));
  let view = null;           // of the map: middle east, middle north, pixels per metre
  let moved = false;         // by a person: then a change of size leaves the view as it is
  let at = null;             // under the cursor: {layer, i}
  let by = '';               // the value that colours lines, '' for their own colours
  let chart = null, log = false, following = false;
  let tiles = '';            // address of the base map's tiles, '' for none
  const images = new Map();  // of the base map, by address

  root.classList.add('interactive');
  layers.forEach(function (layer) {
    const label = document.createElement('label'), box = document.createElement('input');
    const swatch = document.createElement('i');
    box.type = 'checkbox';
    box.checked = layer.shown;
    box.onchange = () => { layer.shown = box.checked; at = null; makeStrip(); draw(); };
    swatch.style.background = layer.dash && layer.dash.length
      ? `repeating-linear-gradient(90deg, ${layer.colour} 0 5px, transparent 5px 8px)` : layer.colour;
    label.append(box, swatch, layer.name);
    root.querySelector('.layers').append(label);
  });

  function extent(some) {
    const box = [Infinity, Infinity, -Infinity, -Infinity];
    for (const l of some) for (let i = 0; i < l.x.length; i++) {
      box[0] = Math.min(box[0], l.x[i]); box[2] = Math.max(box[2], l.x[i]);
      box[1] = Math.min(box[1], l.y[i]); box[3] = Math.max(box[3], l.y[i]);
    }
    return box;
  }

  function fit() {
    const scale = 0.9 * Math.min(map.clientWidth / Math.max(home[2] - home[0], 1),
                                 map.clientHeight / Math.max(home[3] - home[1], 1));
    view = [(home[0] + home[2]) / 2, (home[1] + home[3]) / 2, scale];
    moved = false;
  }

  function context(canvas) {
    const ratio = window.devicePixelRatio || 1, width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const c = canvas.getContext('2d');
    c.setTransform(ratio, 0, 0, ratio, 0, 0);
    c.clearRect(0, 0, width, height);
    c.font = '12px system-ui, sans-serif';
    c.lineJoin = 'round';
    return c;
  }

  const toX = x => map.clientWidth / 2 + (x - view[0]) * view[2];
  const toY = y => map.clientHeight / 2 - (y - view[1]) * view[2];

  function draw() {
    if (!map.clientWidth) return;
    if (!moved) fit();
    drawMap();
    say();
  }

  // first index of each piece of a line: it is not drawn from one outage to the next
  const pieces = l => (l.first || [0]).map((first, k, all) => [first, k + 1 < all.length ? all[k + 1] : l.x.length]);

  function path(c, l, x, y) {
    c.strokeStyle = l.colour;
    c.lineWidth = l.width;
    c.setLineDash(l.dash || []);
    c.beginPath();
    for (const [from, to] of pieces(l)) for (let i = from; i < to; i++) {
      if (i === from) c.moveTo(x(i), y(i)); else c.lineTo(x(i), y(i));
    }
    c.stroke();
    c.setLineDash([]);
  }

  // from dark blue over green to yellow, which those who see few colours can tell apart, too (viridis)
  const VIRIDIS = ['#440154', '#3b528b', '#21918c', '#5ec962', '#fde725'];

  // where the scale of a value ends: 19 of 20 points lie below
  function most(name) {
    const all = layers.filter(l => l.shown && l[name]).flatMap(l => l[name].filter(v => v !== null)).sort((a, b) => a - b);
    return all.length ? all[Math.floor(0.95 * (all.length - 1))] || 1 : 1;
  }

  function coloured(c, l) {
    const top = most(by);
    c.lineWidth = l.width + 1.5;
    for (const [from, to] of pieces(l)) for (let i = from + 1; i < to; i++) {
      if (l[by][i] === null) continue;
      c.strokeStyle = VIRIDIS[Math.min(Math.floor(l[by][i] / top * VIRIDIS.length), VIRIDIS.length - 1)];
      c.beginPath();
      c.moveTo(toX(l.x[i - 1]), toY(l.y[i - 1])); c.lineTo(toX(l.x[i]), toY(l.y[i]));
      c.stroke();
    }
  }

  // The base map: tiles of 256 px in Web Mercator, of the zoom nearest to that of the view. place: latitude and longitude
  // of the origin (rad), metres north and east for a radian of each.
  function drawTiles(c) {
    const [latitude, longitude, north, east] = place;
    const zoom = Math.min(Math.max(Math.round(Math.log2(2 * Math.PI * east * view[2] / 256)), 0), 19), count = 2 ** zoom;
    const column = x => ((longitude + x / east) / (2 * Math.PI) + 0.5) * count;
    const row = y => (0.5 - Math.asinh(Math.tan(latitude + y / north)) / (2 * Math.PI)) * count;
    const edgeX = k => toX(((k / count - 0.5) * 2 * Math.PI - longitude) * east);
    const edgeY = k => toY((Math.atan(Math.sinh((0.5 - k / count) * 2 * Math.PI)) - latitude) * north);
    const w = map.clientWidth / 2 / view[2], h = map.clientHeight / 2 / view[2];
    c.globalAlpha = 0.6;
    for (let i = Math.floor(column(view[0] - w)); i <= column(view[0] + w); i++)
      for (let j = Math.max(Math.floor(row(view[1] + h)), 0); j <= row(view[1] - h) && j < count; j++) {
        const image = tile(zoom, (i + count) % count, j);
        if (image.naturalWidth) c.drawImage(image, edgeX(i), edgeY(j), edgeX(i + 1) - edgeX(i), edgeY(j + 1) - edgeY(j));
      }
    c.globalAlpha = 1;
  }

  function tile(zoom, i, j) {
    const address = tiles.replace('{z}', zoom).replace('{x}', i).replace('{y}', j);
    if (!images.has(address)) {
      const image = new Image();
      image.onload = draw;
      image.onerror = () => { fromText.textContent = 'not every tile of the map could be fetched'; };
      image.src = address;
      images.set(address, image);
    }
    return images.get(address);
  }

  function askForTiles() {
    const answer = tiles ? '' : window.prompt('Address of the map tiles. Their server learns where this drive was.',
                                              'tile.openstreetmap.org/{z}/{x}/{y}.png') || '';
    tiles = answer && !/^\w+:/.test(answer) ? 'https' + '://' + answer : answer;
    fromText.textContent = tiles.includes('openstreetmap.org') ? 'map: \u00a9 OpenStreetMap contributors' : '';
  }

  function drawMap() {
    const c = context(map), ink = getComputedStyle(map).color;
    if (tiles) drawTiles(c);
    for (const l of layers.filter(l => l.shown)) {
      if (l.points) {
        c.strokeStyle = c.fillStyle = l.colour;
        for (let i = 0; i < l.x.length; i++) {
          c.beginPath();
          c.arc(toX(l.x[i]), toY(l.y[i]), l.points, 0, 7);
          if (l.hollow) c.stroke(); else c.fill();
        }
      } else if (by && l[by]) coloured(c, l);
      else path(c, l, i => toX(l.x[i]), i => toY(l.y[i]));
      for (const [x, y, trueX, trueY] of l.ends || []) {
        c.lineWidth = 1.5;
        c.setLineDash([2, 3]);
        c.beginPath(); c.moveTo(toX(x), toY(y)); c.lineTo(toX(trueX), toY(trueY)); c.stroke();
        c.setLineDash([]);
        c.beginPath();
        c.moveTo(toX(x) - 4, toY(y) - 4); c.lineTo(toX(x) + 4, toY(y) + 4);
        c.moveTo(toX(x) - 4, toY(y) + 4); c.lineTo(toX(x) + 4, toY(y) - 4);
        c.stroke();
      }
    }
    if (at) {
      c.strokeStyle = ink;
      c.lineWidth = 2;
      c.beginPath(); c.arc(toX(at.layer.x[at.i]), toY(at.layer.y[at.i]), 6, 0, 7); c.stroke();
    }
    const length = nice(110 / view[2]), bottom = map.clientHeight - 14;
    c.fillStyle = c.strokeStyle = ink;
    c.lineWidth = 2;
    c.beginPath();
    c.moveTo(12, bottom - 5); c.lineTo(12, bottom); c.lineTo(12 + length * view[2], bottom);
    c.lineTo(12 + length * view[2], bottom - 5);
    c.stroke();
    c.fillText(length >= 1000 ? length / 1000 + ' km' : length + ' m', 18, bottom - 6);
    c.fillText('north is up', map.clientWidth - 72, bottom);
  }

  function nice(most) {  // the largest 1, 2 or 5 times a power of ten below `most`
    const power = Math.pow(10, Math.floor(Math.log10(most)));
    return +([5, 2, 1].find(k => k * power <= most) * power).toPrecision(1);
  }

  // uPlot wants times that ascend: outages that overlap become lines of their own
  function rising(l) {
    const found = [];
    for (const [from, to] of pieces(l)) {
      let line = found.find(f => f.t[f.t.length - 1] < l.t[from]);
      if (!line) found.push(line = {...l, t: [], y: [], s: []});
      for (let i = from; i < to; i++) { line.t.push(l.t[i]); line.y.push(l.error[i]); line.s.push(l.sigma ? 2 * l.sigma[i] : null); }
      line.t.push(l.t[to - 1] + 0.001); line.y.push(null); line.s.push(null);  // where the line breaks
    }
    return found;
  }

  function makeStrip() {
    const shown = lines.filter(l => l.shown);
    if (chart) { chart.destroy(); chart = null; }
    if (!shown.length || !strip.clientWidth) return;
    const drawn = shown.flatMap(rising), tables = drawn.map(l => [l.t, l.y]), plain = shown.find(l => !l.first && l.sigma);
    const series = drawn.map(l => ({name: l.name, colour: l.colour, width: Math.min(l.width, 1.5), dash: l.dash}));
    if (plain) {  // twice the filter's own sigma of the first line
      tables.push([plain.t, plain.sigma.map(v => v === null ? null : 2 * v)]);
      series.push({name: '2 sigma', colour: plain.colour, width: 1, dash: [3, 3]});
    }
    const [x, ...ys] = uPlot.join(tables);
    const options = chartOptions(strip.clientWidth, strip.clientWidth < 600 ? 150 : 180, 'm', series,
      {log, named: true, hooks: {setCursor: [u => {
        if (following || u.cursor.left < 0) return;
        at = nearestTime(u.posToVal(u.cursor.left, 'x'));
        drawMap();
        say();
      }]}});
    options.legend = {show: false};
    chart = new uPlot(options, [x, ...drawable(ys, log)], strip);
  }

  function follow() {  // the cursor of the strip goes where that of the map is
    if (!chart || !at) return;
    following = true;
    chart.setCursor({left: chart.valToPos(at.layer.t[at.i], 'x'), top: 0});
    following = false;
  }

  // index of the time next to t, among those from `from` on and before `to`
  function nextTo(times, t, from, to) {
    let low = from, high = to - 1;
    while (high - low > 1) {
      const middle = (low + high) >> 1;
      if (times[middle] <= t) low = middle; else high = middle;
    }
    return Math.abs(times[high] - t) < Math.abs(times[low] - t) ? high : low;
  }

  const text = (value, unit) => value === null || value === undefined ? '–' : +value.toPrecision(3) + unit;

  function say() {
    said.textContent = '';
    said.hidden = !at;
    if (!at) return;
    const t = at.layer.t[at.i], others = [];
    for (const layer of lines.filter(l => l.shown && l !== at.layer))
      for (const [from, to] of pieces(layer)) {  // of outages each that lasts then
        const i = nextTo(layer.t, t, from, to);
        if (Math.abs(layer.t[i] - t) < (layer.first ? 1 : 2)) { others.push({layer, i}); if (layer.first) break; }
      }
    const rows = [at, ...others];
    const head = document.createElement('b');
    head.textContent = +t.toFixed(1) + ' s after the start';
    said.append(head);
    for (const {layer: l, i} of rows) {
      const row = document.createElement('div');
      const sigma = l.sigma ? text(l.sigma[i], ' m') : '–';
      row.textContent = l.name + (l.error ? ': error ' + text(l.error[i], ' m') + ', sigma ' + sigma : '')
        + (l.speed ? ', speed ' + text(l.speed[i], ' m/s') : '');
      said.append(row);
    }
  }

  function nearest(x, y) {
    let best = null, closest = 30 * 30;
    for (const layer of layers.filter(l => l.shown && l.t)) for (let i = 0; i < layer.x.length; i++) {
      const dx = toX(layer.x[i]) - x, dy = toY(layer.y[i]) - y, d = dx * dx + dy * dy - (layer.error ? 4 : 0);
      if (d < closest) { closest = d; best = {layer, i}; }
    }
    return best;
  }

  function nearestTime(t) {
    let best = null, closest = 3;
    for (const layer of lines.filter(l => l.shown)) for (const [from, to] of pieces(layer)) {
      const i = nextTo(layer.t, t, from, to), d = Math.abs(layer.t[i] - t) + (layer.first ? 0.5 : 0);
      if (d < closest) { closest = d; best = {layer, i}; }
    }
    return best;
  }

  function zoomMap(factor, x, y) {
    const scale = Math.min(Math.max(view[2] * factor, 1e-4), 1e4), w = map.clientWidth / 2, h = map.clientHeight / 2;
    view[0] += (x - w) * (1 / view[2] - 1 / scale);
    view[1] -= (y - h) * (1 / view[2] - 1 / scale);
    view[2] = scale;
    moved = true;
  }

  // drag to pan, wheel or two fingers to zoom, hover or tap to read
  function listen(canvas, pan, zoom, find) {
    const fingers = new Map();
    const place = e => { const r = canvas.getBoundingClientRect(); return [e.clientX - r.left, e.clientY - r.top]; };
    canvas.addEventListener('pointerdown', e => {
      fingers.set(e.pointerId, place(e));
      canvas.setPointerCapture(e.pointerId);
      at = find(...place(e));
      follow();
      draw();
    });
    canvas.addEventListener('pointermove', e => {
      const now = place(e), before = fingers.get(e.pointerId);
      if (before) {
        const other = [...fingers].filter(([id]) => id !== e.pointerId).map(([, p]) => p)[0];
        if (other) {
          const apart = p => Math.max(Math.hypot(p[0] - other[0], p[1] - other[1]), 1);
          zoom(apart(now) / apart(before), other[0], other[1]);
        } else pan(now[0] - before[0], now[1] - before[1]);
        fingers.set(e.pointerId, now);
      } else { at = find(...now); follow(); }
      draw();
    });
    for (const name of ['pointerup', 'pointercancel']) canvas.addEventListener(name, e => fingers.delete(e.pointerId));
    canvas.addEventListener('wheel', e => {
      e.preventDefault();
      zoom(Math.exp(-e.deltaY * (e.deltaMode ? 0.05 : 0.0015)), ...place(e));
      draw();
    }, {passive: false});
  }

  function panMap(dx, dy) {
    view[0] -= dx / view[2];
    view[1] += dy / view[2];
    moved = true;
  }
  listen(map, panMap, zoomMap, nearest);
  map.addEventListener('keydown', e => {
    const step = {ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40]}[e.key];
    const factor = {'+': 1.4, '-': 1 / 1.4}[e.key];
    if (!step && !factor) return;
    e.preventDefault();
    if (step) panMap(...step); else zoomMap(factor, map.clientWidth / 2, map.clientHeight / 2);
    draw();
  });
  root.querySelectorAll('button').forEach(button => {
    if (button.dataset.zoom === 'map') button.hidden = !place;
    button.onclick = () => {
      const factor = {in: 1.6, out: 1 / 1.6}[button.dataset.zoom];
      if (button.dataset.zoom === 'log') { log = !log; button.textContent = log ? 'error: linear' : 'error: logarithmic'; makeStrip(); }
      else if (button.dataset.zoom === 'map') { askForTiles(); button.textContent = tiles ? 'no base map' : 'base map ...'; }
      else if (factor) zoomMap(factor, map.clientWidth / 2, map.clientHeight / 2);
      else { fit(); makeStrip(); }
      draw();
    };
  });
  root.querySelector('select').onchange = e => {
    by = e.target.value;
    const unit = by === 'speed' ? ' m/s' : ' m';
    scaleText.textContent = by ? '0 to ' + +most(by).toPrecision(2) + unit + ' and more, dark to light' : '';
    draw();
  };
  let width = 0;
  new ResizeObserver(() => {
    if (strip.clientWidth !== width) { width = strip.clientWidth; makeStrip(); }
    draw();
  }).observe(root);
});
