// The panel of what is selected: a cluster's belief, potential and messages, or an edge's two.

const MOST_ROWS = 64;
const MOST_COLUMNS = 40;
// In place of a picture of beliefs of which nothing is known.
const NOTHING = "infinite deviations: nothing to draw";

class Inspector {
  constructor(panel, source, choose) {
    this.panel = panel;
    this.source = source;
    this.choose = choose;
    this.axes = {};
    this.open = { belief: true, states: true, potential: false, message: false };
  }

  show(selection) {
    const scroll = this.panel.scrollTop;
    const same = this.kind === (selection.edge ? "edge" : "cluster");
    this.kind = selection.edge ? "edge" : "cluster";
    this.selection = selection;
    this.panel.replaceChildren(...(selection.edge ? this.edge(...selection.edge) : this.cluster(selection.cluster)));
    this.panel.scrollTop = same ? scroll : 0;
  }

  cluster(id) {
    const { source } = this;
    const about = source.about(id);
    const senders = source.senders(id);
    const entries = [{ role: "belief", title: "belief", key: "belief", factor: source.belief(id) }];
    (source.gaussians?.(id) ?? []).forEach(({ weight, factor }, k) => {
      entries.push({ role: "third", title: `Gaussian of weight ${short(weight)}`, key: `gaussian-${k}`, factor });
    });
    const tables = (source.tables?.(id) ?? []).map((factor) => (
      { role: "belief", title: `belief of ${factor.variables[0].name}`, key: `states-${factor.variables[0].name}`, factor }));
    senders.forEach((k) => {
      entries.push({
        role: LINES[lineOf(source, k, id)], title: `message ${k} → ${id}`, key: `message-${k}-${id}`, factor: source.message(k, id), from: k,
      });
    });
    entries.push({ role: "potential", title: "potential", key: "potential", factor: source.potential(id) });
    const chips = el("ul", { class: "chips" });
    for (const name of about.variables) {
      chips.append(chip(name, about));
    }
    for (const name of about.observed.slice(0, 40)) chips.append(el("li", { class: "observed", title: "observed" }, name));
    if (about.observed.length > 40) chips.append(el("li", { class: "observed" }, `+${about.observed.length - 40} observed`));
    const cpds = about.cpds.length
      ? el("details", { class: "cpds" }, el("summary", {}, `${about.cpds.length} CPD${about.cpds.length > 1 ? "s" : ""} in its potential`), el("ul", {}, ...about.cpds.map((text) => el("li", {}, text))))
      : el("p", { class: "aside" }, "no CPD of its own: its potential is one");
    const others = about.cut.length ? el("p", { class: "aside" }, `${about.cut.length} more neighbours are not in this page`) : null;
    return [
      el("h2", {}, `Cluster ${id}`), about.role ? el("p", { class: "role" }, about.role) : null, chips, cpds, others, this.picture(entries),
      ...entries.map((entry) => this.section(entry)),
      ...tables.flatMap((entry) => [this.picture([entry]), this.section(entry)]),
    ].filter(Boolean);
  }

  edge(i, j) {
    const { source } = this;
    const [low, high] = [Math.min(i, j), Math.max(i, j)];
    const there = source.message(low, high);
    const back = source.message(high, low);
    const entries = [
      { role: "first", title: `message ${low} → ${high}`, key: `message-${low}-${high}`, factor: there, wide: true },
      { role: "second", title: `message ${high} → ${low}`, key: `message-${high}-${low}`, factor: back, wide: true },
    ];
    const both = product(there, back);
    if (both) entries.unshift({ role: "belief", title: "belief of the sepset: their product", key: "sepset", factor: both });
    const residual = source.residuals(source.iteration ?? null);
    const edge = source.edge(low, high);
    const note = residual && edge.place !== undefined
      ? el("p", { class: "aside" }, "change along this edge: ", el("span", { class: "number" }, shown(residual[edge.place]))) : null;
    const chips = el("ul", { class: "chips" }, ...edge.names.map((name) => el("li", {}, name)));
    const ends = el("p", { class: "ends" }, this.link(low), this.link(high));
    return [el("h2", {}, `Edge ${low} – ${high}`), chips, ends, note, this.picture(entries), ...entries.map((entry) => this.section(entry))].filter(Boolean);
  }

  link(id) {
    return el("button", { type: "button", onclick: () => this.choose({ cluster: id }) }, `cluster ${id}`);
  }

  // Ellipses, densities or bars of all factors that have them, and what is drawn how.
  picture(entries) {
    const box = el("figure", {});
    const tables = entries.filter(({ factor }) => factor.type === "table" || factor.type === "largest");
    const widest = (given) => given.reduce((a, b) => (b.factor.variables.length > a.factor.variables.length ? b : a));
    if (tables.length) {
      const { variables } = widest(tables).factor;
      if (!variables.length) return null;
      const names = variables.map((variable) => variable.name);
      const fallback = this.source instanceof ChainSource ? names.length - 1 : 0;
      this.choice(box, [{ names, label: "variable", fallback, key: "state" }], ([name]) => (
        [this.legend(entries, having(tables, name)), bars(tables, name, variables[names.indexOf(name)].states, this.source.truth(name)?.[0])]));
      return box;
    }
    const drawn = entries.filter(({ factor }) => factor.type === "gaussian" && factor.moments);
    if (!drawn.length || !widest(drawn).factor.variables.length) return null;
    const axes = axesOf(widest(drawn).factor.variables);
    if (axes.names.length === 1) {
      const parts = this.parts(drawn, axes, axes.names);
      box.append(this.legend(entries), parts.length ? bells(parts, axes.names[0]) : NOTHING);
      return box;
    }
    const angles = new Set(widest(drawn).factor.variables.flatMap((v) => v.components.filter((_, k) => v.angles[k])));
    const newest = axes.shared ? 0 : placeOfNewest(widest(drawn).factor.variables);
    const choices = [
      { names: axes.names, label: "across", fallback: newest, key: "x" },
      { names: axes.names, label: "up", fallback: newest + 1, key: "y" },
    ];
    this.choice(box, choices, (wanted) => {
      const same = wanted[0] === wanted[1];
      const parts = this.parts(drawn, axes, same ? wanted.slice(0, 1) : wanted);
      const alike = axes.shared && !wanted.some((name) => angles.has(name));
      if (!parts.length) return [this.legend(entries, parts), NOTHING];
      return [this.legend(entries, parts), same ? bells(parts, wanted[0]) : ellipses(parts, wanted, alike)];
    });
    return box;
  }

  // What is drawn of factors, and the true values of the variables of the widest.
  parts(drawn, axes, wanted) {
    const parts = partsOf(drawn, axes, wanted);
    const found = truthPoints(drawn, axes, wanted, (name) => this.source.truth(name));
    return Object.assign(parts, { truth: parts.length ? found : [] });
  }

  // Selectors whose choice stays from one selection to the next.
  choice(box, choices, draw) {
    const content = el("div", {});
    const selects = choices.map(({ names, label, fallback, key }) => {
      const kept = names.map((name) => name.replace(/\[\d+\]$/, "")).lastIndexOf(this.axes[key] ?? "");
      const at = names.includes(this.axes[`${key} exact`]) ? names.indexOf(this.axes[`${key} exact`]) : kept;
      const chosen = at >= 0 ? at : Math.min(fallback, names.length - 1);
      return el("select", { "aria-label": label, "data-axis": key }, ...names.map((name, k) => (
        el("option", { value: k, selected: k === chosen }, clipped(name, 24)))));
    });
    const redraw = () => content.replaceChildren(...draw(selects.map((select, k) => choices[k].names[Number(select.value)])));
    for (const [k, select] of selects.entries()) {
      select.addEventListener("change", () => {
        const name = choices[k].names[Number(select.value)];
        this.axes[choices[k].key] = name.replace(/\[\d+\]$/, "");
        this.axes[`${choices[k].key} exact`] = name;
        redraw();
      });
    }
    const labels = selects.map((select, k) => el("label", {}, `${choices[k].label} `, select));
    box.append(el("div", { class: "choices" }, ...labels), content);
    redraw();
  }

  legend(entries, parts = null) {
    const drawn = parts && new Set(parts.map((each) => each.role));
    const truth = parts?.truth?.length ? el("li", {}, sample("truth"), "truth") : null;
    const items = entries.map(({ role, title, factor }) => {
      const flat = factor.type === "gaussian" && !factor.moments;
      const missing = factor.type === "none" || flat || (drawn && !drawn.has(role));
      const name = title.replace(/^belief of the sepset.*/, "product");
      const why = flat ? el("span", { class: "aside" }, "no moments") : null;
      return el("li", { class: missing ? "missing" : "" }, sample(role), name, why);
    });
    return el("ul", { class: "legend" }, ...items, truth);
  }

  section({ role, title, key, factor, from, wide }) {
    const kind = key.split("-")[0];
    const details = el("details", { class: "factor", "data-factor": key, open: wide || this.open[kind] });
    details.addEventListener("toggle", () => {
      if (!wide) this.open[kind] = details.open;
    });
    details.append(el("summary", {}, sample(role), el("span", {}, title[0].toUpperCase() + title.slice(1))));
    details.append(...numbersOf(factor, role === "belief" ? (name) => this.source.truth(name) : () => null));
    if (from !== undefined && this.source.node(from)) details.append(el("p", { class: "ends" }, this.link(from)));
    return details;
  }
}

// A variable: whether it was linearised anew, or how far evidence moved it.
function chip(name, { anew, moved, changed }) {
  if (anew?.has(name)) return el("li", { class: "anew", title: "linearised anew by the last addition" }, `${name} anew`);
  if (!moved?.has(name)) return el("li", {}, name);
  const nats = moved.get(name);
  const found = el("li", { class: "moved", title: `${changed}: ${short(nats)} nats` }, name);
  found.style.setProperty("--share", `${Math.round(100 * movedShare(nats))}%`);
  return found;
}

// The product of the two messages of an edge; null where there is none.
function product(a, b) {
  if (a.type === "gaussian" && b.type === "gaussian") {
    const canonical = gaussianProduct(a, [b]);
    return canonical && gaussian(a.variables, { canonical });
  }
  if (a.type === "table" && b.type === "table" && a.variables.length === b.variables.length) {
    return normalised(tableProduct(a.variables, [a, b]));
  }
  return null;
}

// All numbers of a factor.
function numbersOf(factor, truth) {
  if (factor.type === "none") return [el("p", { class: "aside" }, factor.why)];
  if (factor.type === "gaussian") return gaussianNumbers(factor, truth);
  return tableNumbers(factor, truth);
}

// The true values of a factor's components, and the errors of its means in deviations, as columns
// of a table; none where none is known.
function truthColumns(factor, truth) {
  const { mean, cov } = factor.moments;
  const n = mean.length;
  const values = factor.variables.flatMap(({ name, components }) => [...(truth(name) ?? components.map(() => NaN))]);
  if (values.every((value) => value === null || Number.isNaN(value))) return [];
  const turns = factor.variables.flatMap(({ angles }) => angles);
  const errors = values.map((value, k) => {
    if (value === null) return NaN;
    const off = mean[k] - value;
    const wrapped = turns[k] ? off - 2 * Math.PI * Math.round(off / (2 * Math.PI)) : off;
    return wrapped / Math.sqrt(Math.max(cov[k * n + k], 0));
  });
  return [{ name: "truth", values }, { name: "error / deviation", values: errors }];
}

function gaussianNumbers(factor, truth) {
  const found = [];
  const n = factor.labels.length;
  if (!n) return [el("p", { class: "aside" }, "over no variable"), ...(factor.canonical ? [scalar("g", factor.canonical.g)] : [])];
  if (factor.moments) {
    const { mean, cov } = factor.moments;
    const std = Float64Array.from(mean, (_, k) => Math.sqrt(Math.max(cov[k * n + k], 0)));
    const columns = [{ name: "mean", values: [...mean] }, { name: "deviation", values: [...std] }, ...truthColumns(factor, truth)];
    for (const column of columns) column.texts = aligned(column.values);
    const rows = factor.labels.map((label, k) => (
      el("tr", {}, el("th", { scope: "row" }, label), ...columns.map(({ values, texts }) => cell(values[k], texts[k])))));
    found.push(el("h3", {}, "Moments"), wrapped(el("table", { "data-part": "mean" },
      el("thead", {}, el("tr", {}, el("th", {}), ...columns.map(({ name }) => el("th", { scope: "col" }, name)))), el("tbody", {}, ...rows))));
    found.push(el("h4", {}, "covariance"), matrix(factor.labels, cov, "cov"));
  } else {
    found.push(el("p", { class: "aside" }, "no moments: its information is singular, so that it says nothing of some direction"));
  }
  found.push(el("h3", {}, "Canonical form"));
  if (!factor.canonical) return [...found, el("p", { class: "aside" }, factor.why ?? "no canonical form: singular")];
  const { K, h, g } = factor.canonical;
  found.push(el("h4", {}, el("var", {}, "K")), matrix(factor.labels, K, "K"));
  const texts = aligned([...h]);
  found.push(el("h4", {}, el("var", {}, "h")), wrapped(el("table", { "data-part": "h" }, el("tbody", {}, ...factor.labels.map((label, k) => (
    el("tr", {}, el("th", { scope: "row" }, label), cell(h[k], texts[k]))))))));
  found.push(scalar("g", g));
  return found;
}

function scalar(name, value) {
  return wrapped(el("table", { "data-part": name }, el("tbody", {}, el("tr", {}, el("th", { scope: "row" }, el("var", {}, name)), cell(value)))));
}

const wrapped = (node) => el("div", { class: "scroll" }, node);

function matrix(labels, values, part) {
  const n = labels.length;
  const most = Math.min(n, MOST_COLUMNS);
  const columns = Array.from({ length: most }, (_, j) => aligned(Array.from({ length: most }, (_, i) => values[i * n + j])));
  const head = el("tr", {}, el("th", {}), ...labels.slice(0, most).map((label) => el("th", { scope: "col", title: label }, clipped(label.split(" ").at(-1), 10))));
  const rows = labels.slice(0, most).map((label, i) => el("tr", {}, el("th", { scope: "row" }, label), ...columns.map((texts, j) => cell(values[i * n + j], texts[i]))));
  const found = wrapped(el("table", { "data-part": part, class: "matrix" }, el("thead", {}, head), el("tbody", {}, ...rows)));
  if (most < n) found.append(el("p", { class: "aside" }, `the first ${most} of ${n} rows and columns`));
  return found;
}

// The factors over some variable.
const having = (entries, name) => entries.filter(({ factor }) => factor.variables.some((v) => v.name === name));

function tableNumbers(factor, truth) {
  const sparse = factor.type === "largest";
  const total = sparse ? 0 : sum(factor.values);
  const order = Array.from(factor.values.keys());
  if (!sparse && order.length > MOST_ROWS) order.sort((a, b) => factor.values[b] - factor.values[a]);
  const kept = order.slice(0, MOST_ROWS);
  const texts = aligned(kept.map((k) => factor.values[k]));
  // Behind many variables numbers would be out of sight.
  const row = (states, numbers) => (factor.variables.length > 5 ? [...numbers, ...states] : [...states, ...numbers]);
  const rows = kept.map((k, at) => {
    const entry = sparse ? factor.places[k] : k;
    const states = statesAt(factor.variables, entry).map((state) => (
      el("th", { scope: "row", title: state }, clipped(state, 24))));
    const numbers = [cell(factor.values[k], texts[at])];
    if (!sparse) {
      const share = total > 0 ? `${((100 * factor.values[k]) / total).toFixed(2)} %` : "—";
      numbers.push(el("td", { class: "number" }, share));
    }
    return el("tr", { "data-entry": entry }, ...row(states, numbers));
  });
  const names = factor.variables.map(({ name }) => el("th", { scope: "col", title: name }, clipped(name, 20)));
  const columns = (sparse ? ["value"] : ["value", "share"]).map((name) => el("th", { scope: "col", class: "number" }, name));
  const found = [wrapped(el("table", { "data-part": "values", class: "states" },
    el("thead", {}, el("tr", {}, ...row(names, columns))), el("tbody", {}, ...rows)))];
  const aside = (...content) => found.push(el("p", { class: "aside" }, ...content));
  if (!sparse && order.length > MOST_ROWS) aside(`the ${MOST_ROWS} largest of ${thousands(order.length)} entries`);
  if (factor.why) aside(factor.why);
  const known = factor.variables.map((variable) => [variable, truth(variable.name)?.[0]]).filter(([, state]) => Number.isFinite(state));
  if (known.length) aside("truth: ", known.map(([{ name, states }, state]) => `${name} = ${states[state]}`).join(", "));
  found.push(el("p", { class: "aside", "data-part": "scale", "data-value": factor.scale },
    "values times exp(", el("span", { class: "number" }, nats(factor.scale)), ")"));
  return found;
}
