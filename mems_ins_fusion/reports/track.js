'use strict';
// The interactive track: a map to scale above, the error against time below, one cursor for both. No library, no network.
// Data: track.py. All lengths in metres, times in seconds.
document.querySelectorAll('.track').forEach(function (root) {
  const {layers, notes} = JSON.parse(root.querySelector('script[type="application/json"]').textContent);
  const map = root.querySelector('canvas.map'), strip = root.querySelector('canvas.time');
  const said = root.querySelector('.said');
  const lines = layers.filter(l => l.error);
  const home = extent(layers.filter(l => l.shown));
  const span = [Math.min(...lines.map(l => l.t[0])), Math.max(...lines.map(l => l.t[l.t.length - 1]))];
  let view = null;           // of the map: middle east, middle north, pixels per metre
  let moved = false;         // by a person: then a change of size leaves the view as it is
  let range = span.slice();  // of the strip, s
  let at = null;             // under the cursor: {layer, i}

  root.classList.add('interactive');
  layers.forEach(function (layer) {
    const label = document.createElement('label'), box = document.createElement('input');
    const swatch = document.createElement('i');
    box.type = 'checkbox';
    box.checked = layer.shown;
    box.onchange = () => { layer.shown = box.checked; at = null; draw(); };
    swatch.style.background = layer.colour;
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
    range = span.slice();
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
    drawStrip();
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

  function drawMap() {
    const c = context(map);
    for (const l of layers.filter(l => l.shown)) {
      if (l.points) {
        c.strokeStyle = c.fillStyle = l.colour;
        for (let i = 0; i < l.x.length; i++) {
          c.beginPath();
          c.arc(toX(l.x[i]), toY(l.y[i]), l.points, 0, 7);
          if (l.hollow) c.stroke(); else c.fill();
        }
      } else path(c, l, i => toX(l.x[i]), i => toY(l.y[i]));
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
      c.strokeStyle = '#000';
      c.lineWidth = 2;
      c.beginPath(); c.arc(toX(at.layer.x[at.i]), toY(at.layer.y[at.i]), 6, 0, 7); c.stroke();
    }
    const length = nice(110 / view[2]), bottom = map.clientHeight - 14;
    c.fillStyle = c.strokeStyle = '#1c2024';
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

  const left = 46, bottom = 18;
  const toTime = t => left + (t - range[0]) / (range[1] - range[0]) * (strip.clientWidth - left - 6);

  function drawStrip() {
    const c = context(strip), shown = lines.filter(l => l.shown), height = strip.clientHeight - bottom;
    let top = 0;
    for (const l of shown) for (let i = 0; i < l.t.length; i++)
      if (l.t[i] >= range[0] && l.t[i] <= range[1]) top = Math.max(top, l.error[i]);
    top = top * 1.08 || 1;
    const toError = e => height - e / top * (height - 6);
    c.fillStyle = '#57606a';
    c.strokeStyle = '#e4e8ec';
    const grid = nice(top / 2);
    for (let e = 0; e <= top; e += grid) {
      c.beginPath(); c.moveTo(left, toError(e)); c.lineTo(strip.clientWidth, toError(e)); c.stroke();
      c.fillText(+e.toPrecision(3) + ' m', 4, Math.max(toError(e) + 4, 10));
    }
    const step = nice((range[1] - range[0]) / 2.5);
    for (let t = Math.ceil(range[0] / step) * step; t <= range[1]; t += step)
      c.fillText(+t.toPrecision(6) + ' s', Math.min(toTime(t), strip.clientWidth - 40), strip.clientHeight - 4);
    c.fillText('horizontal error', left + 30, 12);
    c.save();
    c.beginPath(); c.rect(left, 0, strip.clientWidth - left, height); c.clip();
    for (const l of shown) {
      path(c, {...l, width: Math.min(l.width, 1.5)}, i => toTime(l.t[i]), i => toError(l.error[i]));
      if (at && at.layer === l && l.sigma)  // twice the filter's own sigma of the line under the cursor
        path(c, {...l, width: 1, dash: [3, 3]}, i => toTime(l.t[i]), i => toError(2 * l.sigma[i]));
    }
    if (at) {
      const x = toTime(at.layer.t[at.i]);
      c.strokeStyle = '#000';
      c.beginPath(); c.moveTo(x, 0); c.lineTo(x, height); c.stroke();
    }
    c.restore();
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

  const text = (value, unit) => value === null || value === undefined ? '–' : value + unit;

  function say() {
    said.textContent = '';
    if (!at) { said.textContent = notes; return; }
    const t = at.layer.t[at.i];
    const rows = [at, ...lines.filter(l => l.shown && l !== at.layer && !l.first)
      .map(layer => ({layer, i: nextTo(layer.t, t, 0, layer.t.length)})).filter(p => Math.abs(p.layer.t[p.i] - t) < 2)];
    const head = document.createElement('b');
    head.textContent = t + ' s after the start';
    said.append(head);
    for (const {layer: l, i} of rows) {
      const row = document.createElement('div');
      const sigma = l.sigma ? text(l.sigma[i], ' m') : '–', nis = l.nis ? text(l.nis[i], '') : '–';
      row.textContent = l.name + (l.error ? ': error ' + text(l.error[i], ' m') + ', sigma ' + sigma : '')
        + (l.speed ? ', speed ' + text(l.speed[i], ' m/s') : '') + (l.nis ? ', NIS of the last fix ' + nis : '');
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

  function nearestTime(x, y) {
    const t = range[0] + (x - left) / (strip.clientWidth - left - 6) * (range[1] - range[0]);
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

  function zoomStrip(factor, x) {
    const t = range[0] + (x - left) / (strip.clientWidth - left - 6) * (range[1] - range[0]);
    range = range.map(edge => t + (edge - t) / factor);
    range = [Math.max(range[0], span[0]), Math.min(range[1], span[1])];
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
      } else at = find(...now);
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
  function panStrip(dx) {
    const by = -dx / (strip.clientWidth - left - 6) * (range[1] - range[0]);
    const kept = Math.max(Math.min(by, span[1] - range[1]), span[0] - range[0]);
    range = range.map(edge => edge + kept);
    moved = true;
  }
  listen(map, panMap, zoomMap, nearest);
  listen(strip, panStrip, zoomStrip, nearestTime);
  map.addEventListener('keydown', e => {
    const step = {ArrowLeft: [40, 0], ArrowRight: [-40, 0], ArrowUp: [0, 40], ArrowDown: [0, -40]}[e.key];
    const factor = {'+': 1.4, '-': 1 / 1.4}[e.key];
    if (!step && !factor) return;
    e.preventDefault();
    if (step) panMap(...step); else zoomMap(factor, map.clientWidth / 2, map.clientHeight / 2);
    draw();
  });
  root.querySelectorAll('button').forEach(button => {
    button.onclick = () => {
      const factor = {in: 1.6, out: 1 / 1.6}[button.dataset.zoom];
      if (factor) zoomMap(factor, map.clientWidth / 2, map.clientHeight / 2); else fit();
      draw();
    };
  });
  new ResizeObserver(draw).observe(root);
  draw();
});
