// Plots that move, legends that switch lines off, tables sorted and filtered. The page is complete without it:
// each drawing stays for print, and the lines of a plot are read back from the paths of its drawing.
"use strict";
const FONT = "11px system-ui, sans-serif", cursor = document.getElementById("cursor");
const short = (x) => String(Number(x.toPrecision(4))).replace("-", "−");
const mark = (x) => { const size = Math.abs(x); return size >= 1e7 || (size >= 1e-12 && size < 1e-4) ? Number(x.toPrecision(4)).toExponential().replace("+", "").replace(/-/g, "−") : size >= 1e4 ? `${short(x / 1e3)}k` : short(x); };
const colorOf = (path) => { const style = getComputedStyle(path); return path.matches(".band") ? style.fill : style.stroke; };
const inkOf = (name) => getComputedStyle(document.documentElement).getPropertyValue(name);
const off = new Set(), views = new Map(), charts = [];

// Runs of points of a path in steps, [[[x, y], ...], ...]; a stroke of dots becomes the dots.
function readRuns(path) {
  const dots = path.matches(".dots");
  return path.getAttribute("d").split(/[ML]/).slice(1).map((run) => {
    const n = run.match(/-?\d+/g).map(Number), points = [[n[0], n[1]]];
    if (dots) for (let y = n[1] + 30; y <= n[1] + n[2]; y += 30) points.push([n[0], y]);
    else if (!run.includes("h")) for (let k = 2; k < n.length; k += 2) points.push([points.at(-1)[0] + n[k], points.at(-1)[1] + n[k + 1]]);
    return points;
  });
}

// Columns and rows of runs [steps], with a gap after each; null if a run goes back in time.
function readTable(runs) {
  const xs = [], ys = [];
  for (const run of runs) {
    if (xs.length) { xs.push(xs.at(-1) + 1e-3); ys.push(null); }
    for (const [x, y] of run) {
      if (xs.length && x < Math.floor(xs.at(-1))) return null;
      xs.push(xs.length && x <= xs.at(-1) ? xs.at(-1) + 1e-3 : x);
      ys.push(y);
    }
  }
  return [xs, ys];
}

// Fill what other tables have more columns for: between two points of a line everything lies on it, in a gap nothing.
function interpolate(xs, ys) {
  let last = -1;
  ys.forEach((y, k) => {
    if (y === undefined) return;
    if (last >= 0 && (y === null || ys[last] === null)) ys.fill(null, last + 1, k);
    else if (last >= 0)
      for (let j = last + 1; j < k; j++) ys[j] = ys[last] + (y - ys[last]) * (xs[j] - xs[last]) / (xs[k] - xs[last]);
    last = k;
  });
}

function logSplits(low, high) {
  const all = [];
  for (let k = Math.floor(Math.log10(low)); k <= Math.log10(high); k++) for (const part of [1, 2, 5]) all.push(part * 10 ** k);
  const within = all.filter((v) => v >= low && v <= high), tens = within.filter((v) => Math.abs(Math.log10(v) % 1) < 1e-9);
  if (within.length < 2) {  // a narrow one has round numbers as a plain axis has
    const power = 10 ** Math.floor(Math.log10((high - low) / 4)), step = power * [1, 2, 5, 10].find((one) => (high - low) / (one * power) <= 4);
    return Array.from({ length: Math.floor(high / step) - Math.ceil(low / step) + 1 }, (_, k) => (Math.ceil(low / step) + k) * step);
  }
  const kept = tens.length > 2 ? tens : within;
  return kept.filter((_, k) => k % Math.ceil(kept.length / 6) === 0);
}

function makeChart(area) {
  const still = area.parentNode, [x0, x1, y0, y1] = area.dataset.edges.split(" ").map(Number);
  const { width, height } = area.viewBox.baseVal, { unit, log } = area.dataset;
  const real = (axis, v) => log.includes(axis) ? 10 ** v : v;
  const toX = (x) => real("x", x0 + x / width * (x1 - x0)), toY = (y) => real("y", y1 - y / height * (y1 - y0));
  const tables = [], series = [{}], bands = [], full = { x: [toX(0), toX(width)], y: [toY(height), toY(0)] };
  for (const path of area.querySelectorAll("path[data-name]")) {
    const stroke = () => colorOf(path), name = path.dataset.name, show = !off.has(name), runs = readRuns(path);
    const kinds = path.matches(".band") ? [runs.filter((_, k) => k % 2 === 0), runs.filter((_, k) => k % 2).map((run) => run.reverse())] : [runs];
    if (kinds.length === 2) bands.push({ series: [series.length, series.length + 1], fill: () => { const c = document.createElement("canvas").getContext("2d"); c.fillStyle = colorOf(path); return `color-mix(in srgb, ${c.fillStyle} 28%, transparent)`; } });
    for (const one of kinds) {
      const table = readTable(one);
      if (!table) return;
      tables.push(table);
      const dots = path.matches(".dots");
      series.push({ label: name, show, stroke, scale: "y", width: kinds.length === 2 ? 0 : 1.4, dash: path.matches(".dashed") ? [5, 4] : undefined,
        paths: dots ? () => null : undefined, points: { show: dots, size: 3, fill: stroke, width: 0 } });
    }
  }
  if (!tables.length) return;
  const [xs, ...columns] = uPlot.join(tables);
  columns.forEach((column, k) => { if (!series[k + 1].points.show) interpolate(xs, column); });
  const data = [xs.map(toX), ...columns.map((column) => column.map((y) => y == null ? y : toY(y)))];
  const kind = "sh".includes(unit) && !log.includes("x") ? "time" : Symbol("alone");
  const viewOf = () => views.get(kind) || full.x;
  const rangeY = (u, low, high) => {
    const all = full.x[0] === viewOf()[0] && full.x[1] === viewOf()[1] && series.every((one) => !off.has(one.label));
    if (all || low === null || !(high > low)) return full.y;
    if (log.includes("y")) return [Math.max(low / 1.1, full.y[0]), Math.min(high * 1.1, full.y[1])];
    const margin = Math.max(0.06 * (high - low), (full.y[1] - full.y[0]) / 200);
    return [Math.max(low - margin, full.y[0]), Math.min(high + margin, full.y[1])];
  };
  const axis = (name, more) => ({ stroke: () => inkOf("--soft"), font: FONT, ticks: { show: false }, ...more,
    ...(log.includes(name) ? { splits: (u, k, low, high) => logSplits(low, high), filter: (u, splits) => splits } : {}) });
  const grid = { stroke: () => inkOf("--rule"), width: 1 };
  const host = document.createElement("div");
  host.className = "chart";
  still.after(host);
  const size = () => ({ width: host.clientWidth, height: Math.round(Math.max(host.clientWidth * 170 / 420, 150)) });
  const u = new uPlot({
    ...size(), legend: { show: false }, padding: [6, 18, 0, 0], series, bands,
    scales: { x: { time: false, auto: false, range: viewOf, distr: log.includes("x") ? 3 : 1 }, y: { range: rangeY, distr: log.includes("y") ? 3 : 1 } },
    axes: [
      axis("x", { grid: { show: false }, size: 22, gap: 3, space: 48, values: (_, splits) => splits.map((v, k) => short(v) + (k === splits.length - 1 && "sh".includes(unit) ? ` ${unit}` : "")) }),
      axis("y", { grid, size: 52, space: 26, values: (_, splits) => splits.map(mark) })],
    cursor: { y: false, drag: { x: true, setScale: false, dist: 8 }, points: { size: 6 }, sync: kind === "time" ? { key: "time", setSeries: false, filters: { pub: (type) => /mouse(move|leave)/.test(type) } } : {},
      bind: { dblclick: () => () => { zoom(kind, null); return null; } } },
    hooks: {
      setSelect: [() => { if (u.select.width > 8) zoom(kind, [u.select.left, u.select.left + u.select.width].map((x) => u.posToVal(x, "x"))); u.setSelect({ width: 0 }, false); }],
      setCursor: [() => { if (u.cursor.event && host.matches(":hover")) showCursor(u, unit, bands); }],
      drawClear: [() => shade(u, area, toX)],
    },
  }, data, host);
  still.classList.add("moving");
  u.over.addEventListener("mouseleave", () => { cursor.hidden = true; });
  new ResizeObserver(() => { if (host.clientWidth && host.clientWidth !== u.width) u.setSize(size()); }).observe(host);
  charts.push({ u, kind, names: series.map((one) => one.label) });
}

// The intervals that the drawing shades.
function shade(u, area, toX) {
  for (const group of area.querySelectorAll(":scope > g")) for (const rect of group.querySelectorAll("rect")) {
    const [left, right] = [rect.x.baseVal.value, rect.x.baseVal.value + rect.width.baseVal.value].map((x) => u.valToPos(toX(x), "x", true));
    const { ctx, bbox } = u, from = Math.max(left, bbox.left), to = Math.min(right, bbox.left + bbox.width);
    ctx.globalAlpha = 0.18;
    ctx.fillStyle = inkOf(group.matches(".fault") ? "--fault" : "--shade");
    if (to > from) ctx.fillRect(from, bbox.top, to - from, bbox.height);
    ctx.globalAlpha = 1;
  }
}

function showCursor(u, unit, bands) {
  const { idx, idxs, left, top } = u.cursor;
  cursor.hidden = idx === null || left < 0;
  if (cursor.hidden) return;
  const texts = new Map([["", `${short(u.posToVal(left, "x"))} ${unit}`]]);
  u.series.forEach((one, k) => {
    const value = k && one.show ? u.data[k][idxs[k]] : null;
    if (!Number.isFinite(value) || bands.some((band) => band.series[1] === k)) return;
    const band = bands.find((found) => found.series[0] === k), low = band && u.data[k + 1][idxs[k + 1]];
    const before = texts.get(one.label);
    texts.set(one.label, band ? `${one.label} ${short(low)} to ${short(value)}` : before ? `${one.label} ${short(value)}${before.slice(one.label.length).replace(/^ (.*)$/, " ($1)")}` : `${one.label} ${short(value)}`);
  });
  cursor.textContent = [...texts.values()].join(", ");
  const rect = u.over.getBoundingClientRect();
  cursor.style.left = `${Math.min(rect.left + left + 14, innerWidth - 240)}px`;
  cursor.style.top = `${rect.top + top + 14}px`;
}

// Plots over time are looked at together, others alone; null shows all again.
function zoom(kind, view) {
  if (view) views.set(kind, view); else views.delete(kind);
  for (const { u, kind: one } of charts) if (one === kind) u.setScale("x", { min: 0, max: 1 }); // its range is the view
}

for (const key of document.querySelectorAll(".legend .key")) {
  key.setAttribute("role", "button");
  key.tabIndex = 0;
  const name = key.dataset.name, turn = () => {
    if (!off.delete(name)) off.add(name);
    for (const one of document.querySelectorAll("[data-name]")) if (one.dataset.name === name) one.classList.toggle("off", off.has(name));
    for (const one of document.querySelectorAll(".legend .key")) if (one.dataset.name === name) one.setAttribute("aria-pressed", String(!off.has(name)));
    for (const { u, names } of charts) names.forEach((one, k) => { if (one === name) u.setSeries(k, { show: !off.has(name) }); });
  };
  key.setAttribute("aria-pressed", "true");
  key.addEventListener("click", turn);
  key.addEventListener("keydown", (event) => { if (event.key === "Enter" || event.key === " ") { event.preventDefault(); turn(); } });
}

const areas = document.querySelectorAll("svg.area");
if (areas.length) {
  const seen = new IntersectionObserver((found) => {
    for (const one of found) if (one.isIntersecting) { seen.unobserve(one.target); makeChart(one.target.querySelector("svg.area")); }
  }, { rootMargin: "400px" });
  for (const area of areas) seen.observe(area.parentNode);
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => charts.forEach(({ u }) => u.redraw(false)));
}

for (const table of document.querySelectorAll("table")) {
  const rowsOf = (body) => [...body.rows].filter((row) => !row.matches(".group")), all = [...table.tBodies].flatMap(rowsOf);
  table.querySelectorAll("thead th").forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      table.querySelectorAll("thead th").forEach((one) => one.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const textOf = (row) => row.cells[column].textContent.trim();
      const compare = (a, b) => {
        const [x, y] = [a, b].map((row) => parseFloat(textOf(row)));
        const order = Number.isNaN(x) || Number.isNaN(y) ? textOf(a).localeCompare(textOf(b)) : x - y;
        return up ? order : -order;
      };
      for (const body of table.tBodies) body.append(...rowsOf(body).sort(compare));
    });
  });
  if (all.length > 7) {
    const field = document.createElement("input");
    field.type = "search";
    field.placeholder = "show rows with …";
    field.setAttribute("aria-label", "Show rows with these words");
    field.addEventListener("input", () => {
      const words = field.value.toLowerCase().split(/\s+/);
      for (const row of all) row.hidden = !words.every((word) => row.textContent.toLowerCase().includes(word));
    });
    table.parentNode.before(field);
  }
}
