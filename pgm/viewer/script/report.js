// The report of a posterior or a study: what each kind of evidence says of it, curves, and the path.

const STATES = { right: ["✓", "right"], look: ["!", "look here"], unknown: ["–", "not known"] };
const WIDE = { width: 720, height: 230, left: 52, right: 12, top: 12, bottom: 34 };

async function started() {
  const read = (id) => document.getElementById(id).textContent;
  const at = (id) => document.getElementById(id);
  const data = JSON.parse(read("data"));
  const numbers = await unpacked(read("numbers"));
  const title = data.title[0].toUpperCase() + data.title.slice(1);
  document.title = `${title} · report`;
  at("title").textContent = title;
  at("facts").replaceChildren(...data.facts.map((fact) => el("span", {}, fact)));
  at("notes").replaceChildren(...data.notes.map((note) => el("p", {}, note)));
  at("glance").append(el("tbody", {}, ...data.sections.map((section, k) => (
    el("tr", {}, el("td", {}, mark(section.state)), el("th", { scope: "row" }, el("a", { href: `#section-${k}` }, section.title)), el("td", {}, section.told))))));
  if (data.chain) drawPath(at("path"), at("tools"), new ChainSource(data.chain, numbers));
  else at("path").remove();
  at("sections").append(...data.sections.map((section, k) => drawnSection(section, `section-${k}`, numbers)));
  document.body.dataset.ready = String(Math.round(performance.now()));
}

// A state by a sign, a colour and a word.
function mark(state) {
  const [sign, word] = STATES[state];
  return el("span", { class: `mark ${state}`, role: "img", "aria-label": word, title: word }, sign);
}

// The viewer's path of a chain, run by run.
function drawPath(box, tools, source) {
  const path = new Trajectory(box, source, ({ cluster }) => path.show(cluster));
  runControls(tools, source.data, (run) => {
    source.run = run;
    path.draw();
  });
}

function drawnSection({ title, state, told, words, tables, curves, charts = [] }, id, numbers) {
  const lines = words.map((text) => el("p", {}, text));
  return el("section", { id }, el("h2", {}, mark(state), title), el("p", { class: "told" }, told), ...lines,
    ...tables.map(drawnSheet), ...curves.map((curve) => drawnCurve(curve, numbers)),
    el("div", { class: "charts" }, ...charts.map((chart) => drawnChart(chart, numbers))));
}

function drawnSheet({ heads, rows }) {
  const cells = (texts, tag) => texts.map((text, k) => el(k ? tag : "th", { scope: k ? null : "row" }, text));
  return el("div", { class: "scroll" }, el("table", {},
    el("thead", {}, el("tr", {}, ...heads.map((text) => el("th", { scope: "col" }, text)))),
    el("tbody", {}, ...rows.map((row) => el("tr", {}, ...cells(row, "td"))))));
}

// A statistic at steps, its band, and the steps that are marked.
function drawnCurve({ title, across, up, steps, values, low, high, log, marked }, numbers) {
  const column = (ref) => ref && new Rows(numbers, ref).column(0);
  const [xs, ys, from, to] = [steps, values, low, high].map(column);
  const level = log ? (value) => Math.log10(value) : (value) => value;
  const all = [...ys, ...(from ?? []), ...(to ?? [])].map(level).filter(Number.isFinite);
  if (!all.length) return null;
  const [least, most] = [Math.min(...all, log ? Infinity : 0), Math.max(...all)];
  const pad = 0.06 * (most - least) || 1;
  const ends = [Math.min(...xs), Math.max(...xs)];
  const span = ends[0] < ends[1] ? ends : [ends[0] - 1, ends[1] + 1];
  const frame = framed(span, [log ? least - pad : least, most + pad], across, log ? `log₁₀ ${up}` : up, title, WIDE);
  const path = (heights) => [...xs].map((x, k) => [x, level(heights[k])]).filter(([, y]) => Number.isFinite(y))
    .map(([x, y]) => `${spot(frame.x(x))} ${spot(frame.y(y))}`);
  for (const [first, last] of marked) {
    const x = frame.x(first);
    frame.clip.append(svg("rect", { class: "lost", x: spot(x), y: 0, width: Math.max(frame.x(last) - x, 2), height: WIDE.height }, svg("title", {}, `lost, steps ${first} to ${last}`)));
  }
  if (from) frame.clip.append(svg("path", { class: "band", d: `M${[...path(from), ...path(to).reverse()].join("L")}Z` }));
  frame.clip.append(svg("path", { class: "shape value", d: `M${path(ys).join("L")}` }));
  if (xs.length <= 120) for (const place of path(ys)) frame.clip.append(svg("circle", { class: "dot first", cx: place.split(" ")[0], cy: place.split(" ")[1], r: 2 }));
  const legend = [["value", up], ...(from ? [["band", "99 % of a right model's"]] : []), ...(marked.length ? [["lost", "lost"]] : [])];
  return el("figure", {}, el("figcaption", {}, title), el("ul", { class: "legend" }, ...legend.map(([role, text]) => el("li", {}, sample(role), text))), frame.root);
}

started().catch((error) => {
  document.getElementById("title").textContent = "This page could not be read";
  document.getElementById("facts").textContent = String(error);
  throw error;
});
