// Sliders, runs, the search field and the keys.

function stepControls(box, source, choose) {
  const range = el("input", { type: "range", min: source.first, max: source.last, value: source.first, step: 1, id: "step", "aria-label": "step" });
  const number = el("input", { type: "number", min: source.first, max: source.last, value: source.first, "aria-label": "step, as a number" });
  const go = (step) => {
    const wanted = Math.min(Math.max(Math.round(Number(step) || 0), source.first), source.last);
    choose({ cluster: wanted });
  };
  range.addEventListener("input", () => go(range.value));
  number.addEventListener("change", () => go(number.value));
  let timer = null;
  const play = el("button", { type: "button", class: "play", "aria-label": "play", "aria-pressed": "false" }, "▶");
  const stop = () => {
    clearInterval(timer);
    timer = null;
    play.textContent = "▶";
    play.setAttribute("aria-pressed", "false");
  };
  const toggle = () => {
    if (timer !== null) {
      stop();
      return;
    }
    if (Number(range.value) >= source.last) go(source.first);
    play.textContent = "❚❚";
    play.setAttribute("aria-pressed", "true");
    timer = setInterval(() => {
      if (Number(range.value) >= source.last) stop();
      else go(Number(range.value) + 1);
    }, 120);
  };
  play.addEventListener("click", toggle);
  const before = el("button", { type: "button", "aria-label": "step before", onclick: () => go(Number(range.value) - 1) }, "‹");
  const after = el("button", { type: "button", "aria-label": "next step", onclick: () => go(Number(range.value) + 1) }, "›");
  box.append(el("div", { class: "control steps" }, play, before, after, el("label", { for: "step" }, "step"), range, number, el("span", { class: "aside" }, `of ${thousands(source.last)}`)));
  return {
    toggle,
    go,
    show(step) {
      range.value = step;
      number.value = step;
    },
  };
}

// The residuals of a schedule: a curve, a slider on it, and what the page shows of the iteration.
function iterationControls(box, source, changed) {
  const container = el("div", { class: "control iterations" });
  box.append(container);
  const build = () => {
    container.replaceChildren();
    source.iteration = null;
    const { went } = source.data.runs[source.run];
    if (!went) return;
    const values = went.residuals;
    const count = values.length;
    const byEdge = Boolean(source.data.runs[source.run].edges?.each);
    const range = el("input", { type: "range", min: 1, max: count, value: count, step: 1, id: "iteration", "aria-label": "iteration" });
    const text = el("output", { for: "iteration", class: "number" });
    const curve = sparkline(values);
    const note = el("span", { class: "aside" });
    const show = () => {
      const k = Number(range.value);
      text.textContent = `${k} of ${count}: residual ${shown(values[k - 1])}`;
      curve.mark(k - 1);
      const last = `beliefs and messages are those after the last iteration${went.converged ? "" : " (not converged)"}`;
      note.textContent = byEdge ? `edges: their change in iteration ${k}; ${last}` : last;
      source.iteration = byEdge ? k - 1 : null;
      changed(source.residuals(source.iteration));
    };
    range.addEventListener("input", show);
    container.append(el("label", { for: "iteration" }, "iteration"), curve.node, range, text, note);
    show();
  };
  build();
  return { build };
}

function sparkline(values) {
  const [width, height] = [120, 30];
  const logs = values.map((value) => (value > 0 ? Math.log10(value) : null));
  const known = logs.filter((value) => value !== null);
  const low = Math.min(...known, 0);
  const high = Math.max(...known, low + 1);
  const x = (k) => 4 + (values.length > 1 ? k / (values.length - 1) : 0.5) * (width - 8);
  const y = (value) => height - 4 - ((value ?? low) - low) / (high - low) * (height - 8);
  const path = logs.map((value, k) => `${x(k).toFixed(1)} ${y(value).toFixed(1)}`).join("L");
  const dot = svg("circle", { r: 3.2, class: "dot second" });
  const node = svg("svg", { class: "sparkline", width, height, role: "img", "aria-label": "residuals, on a scale of decades" }, svg("path", { class: "shape belief", d: `M${path}` }), dot);
  return {
    node,
    mark(k) {
      dot.setAttribute("cx", x(k));
      dot.setAttribute("cy", y(logs[k]));
    },
  };
}

function residualKey() {
  const bar = svg("svg", { width: 132, height: 10, "aria-hidden": "true" });
  for (let k = 0; k < 33; k++) {
    const block = svg("rect", { x: 4 * k, y: 0, width: 4.5, height: 10 });
    block.style.fill = residualColour(10 ** (DECADES * (k / 32 - 1)));
    bar.append(block);
  }
  return el("div", { class: "key" }, el("span", {}, "change along edges"), el("span", { class: "number" }, "≤ 1e−8"), bar, el("span", { class: "number" }, "≥ 1"));
}

// How far evidence moved the beliefs of clusters, and which hold it.
function movedKey(words) {
  const share = (at) => {
    const block = svg("svg", { width: 22, height: 12, class: "node moved", "aria-hidden": "true" }, svg("rect", { x: 1.5, y: 1.5, width: 19, height: 9, rx: 4.5 }));
    block.style.setProperty("--share", `${100 * at}%`);
    return block;
  };
  const holds = svg("svg", { width: 22, height: 12, class: "node evidence", "aria-hidden": "true" }, svg("rect", { x: 1.5, y: 1.5, width: 19, height: 9, rx: 4.5 }));
  return el("div", { class: "key" }, el("span", {}, words), el("span", { class: "number" }, "≤ 0.001"), ...[0, 1 / 3, 2 / 3, 1].map(share), el("span", {}, "≥ 1 nat"), holds, el("span", {}, "holds evidence"));
}

// Of a growing map: the clusters that its last addition touched.
function touchedKey() {
  const block = svg("svg", { width: 22, height: 12, class: "node touched", "aria-hidden": "true" }, svg("rect", { x: 1.5, y: 1.5, width: 19, height: 9, rx: 4.5 }));
  return el("div", { class: "key" }, block, el("span", {}, "touched by the last addition"), el("span", {}, "· factors without their constants"));
}

function touchedFacts({ touched: { cliques, anew } }) {
  return [
    el("span", {}, `${thousands(cliques)} touched by the last addition`),
    el("span", { title: anew.slice(0, 40).join(", ") }, `${counted(anew.length, "variable")} linearised anew`),
  ];
}

function runControls(box, data, changed) {
  if (data.runs.length < 2) return;
  const select = el("select", { id: "run" }, ...data.runs.map((own, k) => (
    el("option", { value: k }, `run ${own.run.length === 1 ? own.run[0] : `(${own.run.join(", ")})`}`))));
  select.addEventListener("change", () => changed(Number(select.value)));
  box.append(el("label", { for: "run", class: "run" }, "run ", select));
}

// A search field with a list of what was found.
function searchField(box, source, choose) {
  const input = el("input", {
    type: "search", placeholder: "find a variable", "aria-label": "find a variable", role: "combobox",
    "aria-expanded": "false", "aria-controls": "found", autocomplete: "off", spellcheck: "false",
  });
  const list = el("ul", { id: "found", role: "listbox", hidden: true });
  let found = [];
  let active = 0;
  const close = () => {
    list.hidden = true;
    input.setAttribute("aria-expanded", "false");
    input.removeAttribute("aria-activedescendant");
  };
  const pickOne = (k) => {
    if (!found[k]) return;
    choose({ cluster: found[k].id });
    close();
    input.blur();
  };
  const mark = () => {
    [...list.children].forEach((item, k) => item.setAttribute("aria-selected", String(k === active)));
    if (found.length) input.setAttribute("aria-activedescendant", `found-${active}`);
  };
  input.addEventListener("input", () => {
    const text = input.value.trim();
    found = text ? source.find(text).slice(0, 12) : [];
    active = 0;
    list.replaceChildren(...(found.length ? found.map((each, k) => el("li", { role: "option", id: `found-${k}`, onmousedown: (event) => {
      event.preventDefault();
      pickOne(k);
    } }, each.text)) : [el("li", { class: "aside" }, "nothing found")]));
    list.hidden = !text;
    input.setAttribute("aria-expanded", String(Boolean(text)));
    mark();
  });
  input.addEventListener("keydown", (event) => {
    if (event.key === "ArrowDown" || event.key === "ArrowUp") {
      event.preventDefault();
      active = Math.min(Math.max(active + (event.key === "ArrowDown" ? 1 : -1), 0), Math.max(found.length - 1, 0));
      mark();
    } else if (event.key === "Enter") {
      pickOne(active);
    } else if (event.key === "Escape") {
      event.stopPropagation();
      input.value = "";
      close();
      input.blur();
    }
  });
  input.addEventListener("blur", close);
  box.append(el("div", { class: "search" }, input, list));
  return input;
}

const KEYS = [
  ["← → ↑ ↓", "to the neighbour in that direction; on a chain ← → are the steps"],
  ["Page ↑ ↓, Home, End", "ten steps on or back, the first and the last step"],
  ["space", "play the steps"],
  ["+ −", "zoom in and out"],
  ["0", "the whole graph"],
  ["/", "find a variable"],
  ["Tab, Enter", "to what is selected and its edges, and choose one"],
  ["?", "this list"],
  ["Esc", "close it"],
];

function helpDialog() {
  const rows = KEYS.map(([key, text]) => el("tr", {}, el("th", { scope: "row" }, el("kbd", {}, key)), el("td", {}, text)));
  const close = el("button", { type: "button" }, "close");
  const dialog = el("dialog", { "aria-labelledby": "help-title" }, el("h2", { id: "help-title" }, "Keys"), el("table", {}, el("tbody", {}, ...rows)),
    el("p", { class: "aside" }, "Click a cluster for its potential, belief and the messages it received; an edge for both its messages. Drag to move, turn the wheel to zoom. Names too small to read are left out: point at a cluster for them, or zoom in. Numbers are shown to six digits; hold the pointer over one for all of them. Ellipses and bands hold 95 %."), close);
  close.addEventListener("click", () => dialog.close());
  document.body.append(dialog);
  return dialog;
}
