// Small pictures of factors: ellipses in a plane, densities on a line, bars of states.

const PICTURE = { width: 420, height: 280, left: 52, right: 12, top: 12, bottom: 34 };

// The line in which something is drawn, for legends.
function sample(role) {
  return svg("svg", { class: "sample", width: 22, height: 10, "aria-hidden": "true" }, svg("path", { class: `shape ${role}`, d: "M1 5H21" }));
}

// The axes that factors can be drawn along: components that variables share, or all labels.
function axesOf(variables) {
  const vectors = variables.filter((variable) => variable.components.length > 1);
  if (!vectors.length && new Set(variables.map(baseName)).size === 1) return { shared: true, names: [baseName(variables[0])] };
  const names = vectors[0]?.components ?? [];
  const same = vectors.length === variables.length
    && vectors.every((variable) => variable.components.join("\n") === names.join("\n"));
  if (same) return { shared: true, names: [...names] };
  const labels = variables.flatMap((variable) => (
    variable.components.length === 1 ? [variable.name]
      : variable.components.map((component) => `${variable.name} ${component}`)));
  return { shared: false, names: labels };
}

// Where the components begin of the last copy of the first variable: x[3], not x[2], as its pose is marked.
function placeOfNewest(variables) {
  const base = baseName(variables[0]);
  const copy = variables.map(baseName).lastIndexOf(base);
  return variables.slice(0, copy).reduce((sum, variable) => sum + variable.components.length, 0);
}

function baseName(variable) {
  return variable.name.replace(/\[\d+\]$/, "");
}

// The parts of factors to draw: one for each variable that has the axes, or for the whole factor.
function partsOf(entries, axes, wanted) {
  const found = [];
  for (const entry of entries) {
    const { factor } = entry;
    if (factor.type !== "gaussian" || !factor.moments) continue;
    const n = factor.labels.length;
    if (!axes.shared) {
      const places = wanted.map((name) => factor.labels.indexOf(name));
      if (places.every((k) => k >= 0)) found.push(part(entry, "", factor, n, places));
      continue;
    }
    let start = 0;
    for (const variable of factor.variables) {
      const from = start;
      start += variable.components.length;
      const places = wanted.map((name) => (
        variable.components.length === 1 ? from : from + variable.components.indexOf(name)));
      found.push(part(entry, variable.name, factor, n, places));
    }
  }
  return found.filter((each) => [...each.mean, ...each.cov].every(Number.isFinite));
}

// The true values of the widest factor's variables on the axes of a picture, those that are known.
function truthPoints(entries, axes, wanted, truth) {
  if (!entries.length) return [];
  const { variables, labels } = entries.reduce((a, b) => (b.factor.variables.length > a.factor.variables.length ? b : a)).factor;
  const missing = (variable) => variable.components.map(() => NaN);
  const known = variables.map((variable) => truth(variable.name) ?? missing(variable));
  const points = axes.shared
    ? variables.map(({ components }, v) => wanted.map((name) => known[v][components.length === 1 ? 0 : components.indexOf(name)]))
    : [wanted.map((name) => known.flatMap((each) => [...each])[labels.indexOf(name)])];
  return points.filter((point) => point.every((value) => value !== null && Number.isFinite(value)));
}

function part(entry, name, factor, n, places) {
  const { mean, cov } = factor.moments;
  return { role: entry.role, title: entry.title, name, mean: pick(mean, places), cov: submatrix(cov, n, places) };
}

// Numbers at which a scale is marked.
function ticks(low, high, count = 5) {
  const span = high - low;
  if (!(span > 0 && Number.isFinite(span))) return [low];
  const raw = span / count;
  const unit = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((k) => k * unit).find((s) => s >= raw) ?? raw;
  const first = Math.ceil(low / step);
  const found = [];
  // Counted from zero, since large numbers have no next one.
  for (let k = 0; k <= count + 1 && (first + k) * step <= high + 1e-9 * span; k++) found.push((first + k) * step);
  return [...new Set(found)];
}

function tickText(value, step) {
  const power = Math.floor(Math.log10(step) + 1e-9);
  const fixed = power >= -6 && Math.abs(value) < 1e9 ? value.toFixed(Math.max(0, -power)) : "";
  if (fixed && fixed.length < 10) return fixed.replace("-", "−");
  if (Math.abs(value) < 1e-9 * step) return "0";
  const digits = Math.floor(Math.log10(Math.abs(value)) + 1e-9) - power;
  return value.toExponential(Math.min(Math.max(digits, 0), 15)).replaceAll("-", "−").replace("e+", "e");
}

// A place on a picture as text, for paths; what is far outside stays where paths may go.
function spot(value) {
  return Math.min(Math.max(value, -1e5), 1e5).toFixed(2);
}

function framed([x0, x1], [y0, y1], xName, yName, label, size = PICTURE) {
  const { width, height, left, right, top, bottom } = size;
  const x = (value) => left + (value - x0) / (x1 - x0) * (width - left - right);
  const y = (value) => height - bottom - (value - y0) / (y1 - y0) * (height - top - bottom);
  const root = svg("svg", { class: "picture", viewBox: `0 0 ${width} ${height}`, role: "img", "aria-label": label });
  const clip = svg("svg", {
    x: left, y: top, width: width - left - right, height: height - top - bottom,
    viewBox: `${left} ${top} ${width - left - right} ${height - top - bottom}`,
  });
  const lines = svg("g", { class: "grid" });
  const xs = ticks(x0, x1, 6);
  const ys = yName === null ? [] : ticks(y0, y1, 5);
  for (const value of xs) {
    lines.append(svg("line", { x1: x(value), x2: x(value), y1: top, y2: height - bottom }));
    lines.append(svg("text", { x: x(value), y: height - bottom + 14, class: "across" }, tickText(value, xs[1] - xs[0] || 1)));
  }
  for (const value of ys) {
    lines.append(svg("line", { x1: left, x2: width - right, y1: y(value), y2: y(value) }));
    lines.append(svg("text", { x: left - 6, y: y(value) + 3.5, class: "down" }, tickText(value, ys[1] - ys[0] || 1)));
  }
  lines.append(svg("text", { x: 0.5 * (left + width - right), y: height - 4, class: "across name" }, clipped(xName, 40)));
  if (yName !== null) {
    lines.append(svg("text", {
      class: "across name", transform: `translate(11 ${0.5 * (top + height - bottom)}) rotate(-90)`,
    }, clipped(yName, 30)));
  }
  root.append(lines, clip);
  return { root, clip, x, y };
}

function ellipses(parts, names, alike) {
  const { width, height, left, right, top, bottom } = PICTURE;
  const reach = (each, k) => 2.45 * Math.sqrt(Math.max(each.cov[3 * k], 0));
  const main = parts.filter((each) => each.role === "belief");
  const lead = main.length ? main : parts;
  const limits = [0, 1].map((k) => {
    const size = Math.max(...lead.map((each) => reach(each, k)));
    // Messages much wider than the beliefs run out of the picture.
    const near = parts.filter((each) => lead.includes(each) || reach(each, k) < 2.5 * size);
    const low = Math.min(...near.map((each) => each.mean[k] - reach(each, k)), ...parts.truth.map((point) => point[k]));
    const high = Math.max(...near.map((each) => each.mean[k] + reach(each, k)), ...parts.truth.map((point) => point[k]));
    const pad = 0.08 * (high - low) || 1;
    return [low - pad, high + pad];
  });
  if (alike) {
    const room = [width - left - right, height - top - bottom];
    const scale = Math.max(...limits.map(([low, high], k) => (high - low) / room[k]));
    limits.forEach(([low, high], k) => {
      const extra = 0.5 * (scale * room[k] - (high - low));
      limits[k] = [low - extra, high + extra];
    });
  }
  const frame = framed(limits[0], limits[1], names[0], names[1], `95 % ellipses of ${names.join(" and ")}`);
  for (const each of parts) {
    const points = [];
    const { long, short: narrow, angle } = ellipseOf(each.cov[0], each.cov[1], each.cov[3]);
    for (let k = 0; k < 72; k++) {
      const turn = (2 * Math.PI * k) / 72;
      const [a, b] = [long * Math.cos(turn), narrow * Math.sin(turn)];
      points.push(`${spot(frame.x(each.mean[0] + a * Math.cos(angle) - b * Math.sin(angle)))} ${
        spot(frame.y(each.mean[1] + a * Math.sin(angle) + b * Math.cos(angle)))}`);
    }
    frame.clip.append(svg("path", { class: `shape ${each.role}`, d: `M${points.join("L")}Z` }, svg("title", {}, `${each.title} ${each.name}`)));
    frame.clip.append(svg("circle", { class: `dot ${each.role}`, cx: spot(frame.x(each.mean[0])), cy: spot(frame.y(each.mean[1])), r: 2.4 }));
    if (each.role === "belief" && each.name && main.length > 1) {
      // At the end of the long axis that is further from the other ellipses.
      const ends = [1, -1].map((sign) => [long * sign * Math.cos(angle), long * sign * Math.sin(angle)]);
      const others = main.filter((other) => other !== each).map((other) => [0, 1].map((k) => other.mean[k] - each.mean[k]));
      const apart = ends.map(([a, b]) => Math.min(...others.map(([x, y]) => Math.hypot(x - a, y - b))));
      const [across, up] = ends[apart[1] > apart[0] ? 1 : 0];
      const place = { x: frame.x(each.mean[0] + across) + (across >= 0 ? 4 : -4), y: frame.y(each.mean[1] + up) + (up >= 0 ? -4 : 12) };
      frame.clip.append(svg("text", { class: "mark", ...place, "text-anchor": across >= 0 ? "start" : "end" }, clipped(each.name, 16)));
    }
  }
  for (const [a, b] of parts.truth) {
    const place = `translate(${spot(frame.x(a))} ${spot(frame.y(b))})`;
    frame.clip.append(svg("path", { class: "shape truth", transform: place.replaceAll(" ", ","), d: "M-5 -5L5 5M-5 5L5 -5" }, svg("title", {}, "truth")));
  }
  return frame.root;
}

function bells(parts, name) {
  const std = (each) => Math.sqrt(Math.max(each.cov[0], 0));
  const main = parts.filter((each) => each.role === "belief");
  const lead = main.length ? main : parts;
  const size = Math.max(...lead.map(std));
  const near = parts.filter((each) => lead.includes(each) || std(each) < 6 * size);
  const low = Math.min(...near.map((each) => each.mean[0] - 3.2 * std(each)), ...parts.truth.flat());
  const high = Math.max(...near.map((each) => each.mean[0] + 3.2 * std(each)), ...parts.truth.flat());
  const least = Math.min(...parts.map(std).filter((value) => value > 0));
  const limits = low < high ? [low, high] : [low - 1, low + 1];
  const frame = framed(limits, [0, 1.08], name, null, `densities of ${name}`);
  for (const each of parts) {
    const points = [];
    // A value that is certain has no density: it is a line as high as the highest.
    if (!std(each)) points.push(...[0, 1].map((height) => `${spot(frame.x(each.mean[0]))} ${spot(frame.y(height))}`));
    for (let k = 0; std(each) && k <= 160; k++) {
      const value = limits[0] + (k / 160) * (limits[1] - limits[0]);
      const z = (value - each.mean[0]) / std(each);
      points.push(`${spot(frame.x(value))} ${spot(frame.y(Math.exp(-0.5 * z * z) * least / std(each)))}`);
    }
    frame.clip.append(svg("path", { class: `shape ${each.role}`, d: `M${points.join("L")}` }, svg("title", {}, `${each.title} ${each.name}`)));
  }
  for (const [value] of parts.truth) {
    frame.clip.append(svg("path", { class: "shape truth", d: `M${spot(frame.x(value))} ${spot(frame.y(0))}L${spot(frame.x(value))} ${spot(frame.y(1.08))}` }, svg("title", {}, "truth")));
  }
  return frame.root;
}

// Bars of the states of one variable, for each factor that has it; the true one is named so.
function bars(entries, name, states, truth) {
  const rows = el("div", { class: "bars", role: "img", "aria-label": `probabilities of ${name}` });
  const found = [];
  for (const entry of entries) {
    const { factor } = entry;
    if (factor.type !== "table" && factor.type !== "largest") continue;
    const axis = factor.variables.findIndex((variable) => variable.name === name);
    if (axis >= 0) found.push({ role: entry.role, title: entry.title, values: marginalOf(factor, axis) });
  }
  states.slice(0, 60).forEach((state, k) => {
    const stack = el("div", { class: "stack" });
    for (const { role, title, values } of found) {
      const bar = el("div", { class: `bar ${role}`, title: `${title}: ${shown(values[k])}` });
      bar.style.width = `${100 * values[k]}%`;
      stack.append(bar);
    }
    rows.append(el("div", { class: k === truth ? "state true" : "state" }, clipped(state, 18), k === truth ? " (truth)" : ""), stack, el("div", { class: "number" }, found.length ? values3(found[0].values[k]) : ""));
  });
  if (states.length > 60) rows.append(el("div", { class: "state" }, `+${states.length - 60} states`));
  return rows;
}

const values3 = (value) => value.toFixed(4);
