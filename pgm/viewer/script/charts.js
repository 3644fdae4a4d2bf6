// Charts of a study: a curve a method, with the band of its standard errors.

const LOOKS = ["one", "two", "three", "four", "five", "six"];

const CHART = { width: 500, height: 215, left: 52, right: 10, top: 10, bottom: 34 };

// A colour and dashes for each method; dashes let curves be seen that lie under others.
function lookOf(k) {
  const dash = ["", " dashed", " dotted"][(k + Math.floor(k / LOOKS.length)) % 3];
  return `series ${LOOKS[k % LOOKS.length]}${dash}`;
}

function drawnChart({ title, up, right, series }, numbers) {
  const every = series.map((each, k) => {
    const column = (ref) => [...new Rows(numbers, ref).column(0)];
    return { name: each.name, look: lookOf(k), xs: column(each.steps), ys: column(each.values), low: column(each.low), high: column(each.high) };
  });
  const heights = every.flatMap(({ ys, low, high }) => [...ys, ...low, ...high]).concat(right ?? []).filter(Number.isFinite);
  const steps = every.flatMap(({ xs }) => xs);
  if (!steps.length) return null;
  const [least, most] = [Math.min(...heights), Math.max(...heights)];
  const pad = 0.06 * (most - least) || 1;
  const ends = [Math.min(...steps), Math.max(...steps)];
  const span = ends[0] < ends[1] ? ends : [ends[0] - 1, ends[1] + 1];
  const frame = framed(span, [least - pad, most + pad], "step", up, title, CHART);
  const points = (xs, ys) => xs.map((x, k) => `${spot(frame.x(x))} ${spot(frame.y(ys[k]))}`);
  for (const { look, xs, low, high } of every) {
    if (xs.length) frame.clip.append(svg("path", { class: `band ${look}`, d: `M${[...points(xs, low), ...points(xs, high).reverse()].join("L")}Z` }));
  }
  if (right !== null) frame.clip.append(svg("path", { class: "shape right", d: `M${spot(frame.x(span[0]))} ${spot(frame.y(right))}L${spot(frame.x(span[1]))} ${spot(frame.y(right))}` }));
  for (const { name, look, xs, ys } of every) {
    if (xs.length) frame.clip.append(svg("path", { class: `shape ${look}`, d: `M${points(xs, ys).join("L")}` }, svg("title", {}, name)));
    if (xs.length <= 40) for (const place of points(xs, ys)) frame.clip.append(svg("circle", { class: `dot ${look}`, cx: place.split(" ")[0], cy: place.split(" ")[1], r: 2.2 }));
  }
  const legend = [...every.map(({ name, look }) => [look, name]), ...(right === null ? [] : [["right", "right"]])];
  return el("figure", {}, el("figcaption", {}, title), el("ul", { class: "legend" }, ...legend.map(([role, text]) => el("li", {}, sample(role), text))), frame.root);
}
