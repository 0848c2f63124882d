// What a page is like in a browser: width, contrast, requests, errors; the answer replaces the page.
const light = (c) => { const v = c.map((x) => { x /= 255; return x <= 0.03928 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4; });
  return 0.2126 * v[0] + 0.7152 * v[1] + 0.0722 * v[2]; };
const parse = (text) => text.match(/[\d.]+/g).map(Number);
const backOf = (one) => { for (; one; one = one.parentElement) { const c = parse(getComputedStyle(one).backgroundColor);
  if (c.length < 4 || c[3] > 0) return c.slice(0, 3); } return [255, 255, 255]; };
let least = 99;
for (const one of document.querySelectorAll("h1,h2,h3,p,span,th,td,small,dt,dd,a,summary,figcaption,code,b")) {
  if (!one.textContent.trim() || !one.getClientRects().length) continue;
  const [a, b] = [light(parse(getComputedStyle(one).color)), light(backOf(one))].sort((x, y) => y - x);
  least = Math.min(least, (a + 0.05) / (b + 0.05));
}
document.querySelector("svg.area").parentNode.dispatchEvent(new PointerEvent("pointermove", { clientX: 200, clientY: 200 }));
const cut = "details:not([open]) *, .phases *, svg *, .quiet .legend, .quiet .legend *, #cursor", hidden = MEDIUM === "print" ? cut : `.scroll *, ${cut}`;
const width = document.documentElement.getBoundingClientRect().right;
const beyond = [...document.querySelectorAll("body *")].filter((one) => !one.matches(hidden) && one.getBoundingClientRect().right > width + 0.5);
const errorsTop = document.querySelector(".errors").getBoundingClientRect().top + scrollY;
const found = { top: errorsTop, above: document.querySelector(".worst").getBoundingClientRect().bottom + scrollY, beyond: beyond.map((one) => `${one.tagName} ${one.getAttribute("class")} in ${one.parentElement.tagName} ${one.parentElement.id}`), least, requests: performance.getEntriesByType("resource").length,
  width: Math.round(document.documentElement.getBoundingClientRect().width), dark: matchMedia('(prefers-color-scheme: dark)').matches, errors: window.problems, cursor: document.getElementById("cursor").textContent, sorted: document.querySelectorAll("thead button").length };
document.documentElement.innerHTML = "<body><pre id='found'>" + JSON.stringify(found) + "</pre></body>";
