// What a page is like in a browser: width, contrast, requests, errors; the answer replaces the page.
const light = (c) => { const v = c.map((x) => { x /= 255; return x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4; });
  return 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2]; };
const parse = (text) => text.match(/[\d.]+/g).map(Number);
const backOf = (one) => { for (; one; one = one.parentElement) { const c = parse(getComputedStyle(one).backgroundColor);
  if (c.length < 4 || c[3] > 0) return c.slice(0, 3); } return [255, 255, 255]; };
// What the mouse makes of the first plot, as far as there is one on the screen.
const settle = () => new Promise((done) => setTimeout(done, 50));
const movePlot = async () => {
  const { u, names } = charts[0], over = u.over.getBoundingClientRect();
  const send = (type, part, target = u.over) => target.dispatchEvent(new MouseEvent(type, { bubbles: true, movementX: 9, clientX: over.left + part * over.width, clientY: over.top + 20 }));
  const line = u.data[0].map((t, k) => [t, u.data[1][k]]), before = [u.scales.y.min, u.scales.y.max];
  u.setCursor({ left: 0.5 * over.width, top: 20 });
  showCursor(u, "s", []);
  const words = cursor.textContent;
  const key = document.querySelector(`.legend [data-name="${names.at(-1)}"]`);
  key.click();
  await settle();
  const switched = charts.map(({ u: one, names: all }) => all.every((name, k) => !k || one.series[k].show === (name !== names.at(-1))));
  key.click();
  await settle();
  for (const [type, part] of [["mousemove", 0.25], ["mousedown", 0.25], ["mousemove", 0.5], ["mouseup", 0.5]]) send(type, part, type === "mouseup" ? document : u.over);
  await settle();
  const zoomed = charts.filter((one) => one.kind === "time").map(({ u: one }) => [one.scales.x.min, one.scales.x.max]), closer = [u.scales.y.min, u.scales.y.max];
  send("dblclick", 0.5);
  await settle();
  return { cursor: words, line, before, closer, switched: switched.every(Boolean), zoomed, back: [u.scales.x.min, u.scales.x.max], count: charts.length };
};
// The words that the rows of the first table begin with: those that are left of it by a word, and by its last column.
const useTable = () => {
  const field = document.querySelector("input[type=search]"), table = document.querySelector("table.figures");
  const rows = () => [...table.querySelectorAll("tbody tr:not(.group):not([hidden])")];
  field.value = "heading";
  field.dispatchEvent(new Event("input"));
  const left = rows().map((row) => row.textContent);
  field.value = "";
  field.dispatchEvent(new Event("input"));
  table.querySelector("thead th:last-child button").click();
  const order = [...table.tBodies].map((body) => [...body.rows].slice(1).map((row) => parseFloat(row.lastElementChild.textContent)));
  return { left, order, whole: rows().length };
};
requestAnimationFrame(() => setTimeout(async () => {
  const moved = MEDIUM === "print" ? {} : { ...await movePlot(), ...useTable() };
  let least = 99;
  for (const one of document.querySelectorAll("h1,h2,h3,p,span,th,td,small,dt,dd,a,summary,figcaption,code,b")) {
    if (!one.textContent.trim() || !one.getClientRects().length) continue;
    const [a, b] = [light(parse(getComputedStyle(one).color)), light(backOf(one))].sort((x, y) => y - x);
    least = Math.min(least, (a + 0.05) / (b + 0.05));
  }
  const cut = "details:not([open]) *, .phases *, svg *, .quiet .legend, .quiet .legend *, #cursor", hidden = MEDIUM === "print" ? cut : `.scroll *, ${cut}`;
  const width = document.documentElement.getBoundingClientRect().right;
  const beyond = [...document.querySelectorAll("body *")].filter((one) => !one.matches(hidden) && one.getBoundingClientRect().right > width + 0.5);
  const errorsTop = document.querySelector(".errors").getBoundingClientRect().top + scrollY;
  const found = { top: errorsTop, above: document.querySelector(".worst").getBoundingClientRect().bottom + scrollY, beyond: beyond.map((one) => `${one.tagName} ${one.getAttribute("class")} in ${one.parentElement.tagName} ${one.parentElement.id}`), least, requests: performance.getEntriesByType("resource").length,
    width: Math.round(document.documentElement.getBoundingClientRect().width), dark: matchMedia('(prefers-color-scheme: dark)').matches, errors: window.problems, ...moved, sorted: document.querySelectorAll("thead button").length };
  document.documentElement.innerHTML = "<body><pre id='found'>" + JSON.stringify(found) + "</pre></body>";
}, 500));
