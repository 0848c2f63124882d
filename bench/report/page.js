// Cursor values, zoom that all plots share, and tables sorted by a click. The page is complete without it.
"use strict";
const areas = [...document.querySelectorAll("svg.area")].map((svg) => {
  const [t0, t1, low, high] = svg.dataset.edges.split(" ").map(Number);
  const box = svg.viewBox.baseVal;
  const { unit, log } = svg.dataset;
  return { svg, t0, t1, low, high, unit, log, width: box.width, height: box.height, lines: null };
});
const cursor = document.getElementById("cursor");
const toValue = (area, axis, x) => area.log.includes(axis) ? 10 ** x : x;
const short = (x) => String(Number(x.toPrecision(4))).replace("-", "−");

// The points of each line, read back from its path: [[x, y], ...] in steps.
function readLines(area) {
  if (area.lines) return area.lines;
  const keys = [...area.svg.closest("figure").querySelectorAll(".legend .key")];
  area.lines = [...area.svg.querySelectorAll("path.line")].map((path) => {
    const points = [];
    for (const run of path.getAttribute("d").split("M").slice(1)) {
      const n = run.match(/-?\d+/g).map(Number);
      let [x, y] = n;
      points.push([x, y]);
      if (run.includes("h")) continue;
      for (let k = 2; k < n.length; k += 2) points.push([(x += n[k]), (y += n[k + 1])]);
    }
    const colour = path.style.getPropertyValue("--c");
    const key = keys.find((one) => one.firstChild.style.getPropertyValue("--c") === colour && one.firstChild.className === path.getAttribute("class"));
    return { points, name: key ? key.textContent : "" };
  });
  return area.lines;
}

function findValue(points, x) {
  let a = 0, b = points.length - 1;
  if (b < 0 || x < points[0][0] - 5 || x > points[b][0] + 5) return NaN;
  while (b - a > 1) { const m = (a + b) >> 1; if (points[m][0] <= x) a = m; else b = m; }
  const [p, q] = [points[a], points[b]];
  return q[0] === p[0] ? p[1] : p[1] + (q[1] - p[1]) * Math.min(Math.max((x - p[0]) / (q[0] - p[0]), 0), 1);
}

function showCursor(area, event) {
  const rect = area.svg.getBoundingClientRect(), view = area.svg.viewBox.baseVal;
  const x = view.x + (event.clientX - rect.left) / rect.width * view.width;
  const t = area.t0 + x / area.width * (area.t1 - area.t0);
  const texts = [`${short(toValue(area, "x", t))} ${area.unit}`];
  for (const { points, name } of readLines(area)) {
    const value = area.high - findValue(points, x) / area.height * (area.high - area.low);
    if (Number.isFinite(value)) texts.push(`${name} ${short(toValue(area, "y", value))}`);
  }
  cursor.textContent = texts.join(", ");
  cursor.hidden = false;
  cursor.style.left = `${Math.min(event.clientX + 14, innerWidth - 240)}px`;
  cursor.style.top = `${event.clientY + 14}px`;
}

// Plots over time are looked at together, others alone.
function zoom(chosen, from, to) {
  for (const area of areas) {
    if (area !== chosen && (chosen.unit !== "s" || area.unit !== "s" || chosen.log !== area.log)) continue;
    const scale = area.width / (area.t1 - area.t0);
    area.svg.setAttribute("viewBox", `${(from - area.t0) * scale} 0 ${(to - from) * scale} ${area.height}`);
    markTimes(area, from, to);
  }
}

function markTimes(area, from, to) {
  const group = area.svg.parentNode.querySelector(".times"), left = area.svg.x.baseVal.value, wide = area.svg.width.baseVal.value;
  let step = 10 ** Math.floor(Math.log10((to - from) / 6));
  for (const factor of [2, 2.5, 2]) if ((to - from) / step > 7) step *= factor;
  const bottom = group.dataset.y || (group.dataset.y = group.firstChild.getAttribute("y"));
  group.replaceChildren();
  const write = (x, anchor, words) => {
    const text = document.createElementNS("http://www.w3.org/2000/svg", "text");
    text.setAttribute("x", x);
    text.setAttribute("y", bottom);
    text.setAttribute("text-anchor", anchor);
    text.textContent = words;
    group.append(text);
  };
  const timed = area.unit === "s" && !area.log, last = timed ? to - 0.12 * (to - from) : to + 1e-9;
  for (let k = Math.ceil(from / step - 1e-9); k * step <= last; k++)
    write(left + (k * step - from) / (to - from) * wide, "middle", short(toValue(area, "x", k * step)));
  if (timed) write(left + wide + 12, "end", `${short(to)} s`);
}

let dragged = null;
for (const area of areas) {
  const timeAt = (event) => {
    const rect = area.svg.getBoundingClientRect(), view = area.svg.viewBox.baseVal;
    const x = view.x + (event.clientX - rect.left) / rect.width * view.width;
    return area.t0 + Math.min(Math.max(x / area.width, 0), 1) * (area.t1 - area.t0);
  };
  const plot = area.svg.parentNode;
  plot.addEventListener("pointermove", (event) => showCursor(area, event));
  plot.addEventListener("pointerleave", () => { cursor.hidden = true; });
  plot.addEventListener("pointerdown", (event) => { dragged = { area, from: timeAt(event), x: event.clientX }; });
  plot.addEventListener("pointerup", (event) => {
    if (dragged && dragged.area === area && Math.abs(event.clientX - dragged.x) > 8) {
      const ends = [dragged.from, timeAt(event)].sort((a, b) => a - b);
      if (ends[1] > ends[0]) zoom(area, ...ends);
    }
    dragged = null;
  });
  plot.addEventListener("dblclick", () => zoom(area, area.t0, area.t1));
}

for (const table of document.querySelectorAll("table")) {
  table.querySelectorAll("thead th").forEach((head, column) => {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = head.textContent;
    head.replaceChildren(button);
    button.addEventListener("click", () => {
      const up = head.getAttribute("aria-sort") !== "ascending";
      table.querySelectorAll("thead th").forEach((one) => one.removeAttribute("aria-sort"));
      head.setAttribute("aria-sort", up ? "ascending" : "descending");
      const body = table.tBodies[0], textOf = (row) => row.cells[column].textContent.trim();
      const compare = (a, b) => {
        const [x, y] = [a, b].map((row) => parseFloat(textOf(row)));
        const order = Number.isNaN(x) || Number.isNaN(y) ? textOf(a).localeCompare(textOf(b)) : x - y;
        return up ? order : -order;
      };
      body.append(...[...body.rows].sort(compare));
    });
  });
}
