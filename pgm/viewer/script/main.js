// The page comes to life.

async function started() {
  const read = (id) => document.getElementById(id).textContent;
  const data = JSON.parse(read("data"));
  const numbers = await unpacked(read("numbers"));
  const at = (id) => document.getElementById(id);
  const chain = data.kind === "chain";
  const source = chain ? new ChainSource(data, numbers) : new GraphSource(data, numbers);
  document.body.classList.add(chain ? "chain" : "graph");

  const title = chain ? `${data.about} ${data.graph}` : data.graph;
  at("title").textContent = title[0].toUpperCase() + title.slice(1);
  document.title = `${title} · pgm`;
  const count = chain ? data.steps.end + 1 : data.clusters.length;
  const facts = () => {
    const { log_evidence: evidence } = data.runs[source.run];
    const edges = chain ? [] : [el("span", {}, counted(data.edges.length, "edge"))];
    const about = data.touched ? touchedFacts(data) : [
      el("span", {}, "ln p(evidence) ", el("span", { class: "number" }, nats(evidence)), ` ${data.evidence}`)];
    at("facts").replaceChildren(el("span", {}, counted(count, "cluster")), ...edges, ...about);
  };
  at("notes").replaceChildren(...data.notes.map((note) => el("p", {}, note)));

  let selection = null;
  let steps = null;
  let trajectory = null;
  const drawing = new Drawing(at("graph"), source, {
    curved: chain || data.graph !== "cluster graph with loops", choose,
  });
  // No arrow says that a message was sent that was not.
  at("graph").classList.toggle("silent", Boolean(data.words?.messages));
  at("graph").classList.toggle("forth", Boolean(data.words?.back));
  const inspector = new Inspector(at("inspector"), source, choose);

  function choose(wanted) {
    selection = wanted;
    drawing.select(wanted);
    inspector.show(wanted);
    const step = wanted.cluster ?? wanted.edge[0];
    steps?.show(step);
    trajectory?.show(step);
    const text = wanted.edge ? `edge ${wanted.edge.join(" to ")}` : `cluster ${wanted.cluster}`;
    at("said").textContent = text;
    document.body.dataset.selected = text;
  }

  const bar = at("controls");
  if (chain) {
    trajectory = new Trajectory(at("trajectory"), source, choose);
    if (source.last > source.first) steps = stepControls(bar, source, choose);
  }
  const residuals = data.runs.some((run) => run.edges);
  if (data.runs.some((run) => Object.keys(run.moved ?? {}).length)) at("keys").append(movedKey(source.changed));
  if (residuals) at("keys").append(residualKey());
  if (data.touched) at("keys").append(touchedKey());
  const iterations = iterationControls(bar, source, (values) => {
    drawing.showResiduals(values);
    if (selection?.edge) inspector.show(selection);
  });
  bar.hidden = !bar.querySelector("input");
  const field = searchField(at("tools"), source, (wanted) => {
    choose(wanted);
    drawing.approach(wanted.cluster);
  });
  runControls(at("tools"), data, (run) => {
    source.run = run;
    facts();
    drawing.redraw();
    iterations.build();
    choose(selection);
  });
  const help = helpDialog();
  const tool = (text, label, act) => el("button", { type: "button", title: label, "aria-label": label, onclick: act }, text);
  at("zoom").append(
    tool("+", "zoom in", () => drawing.zoomBy(1.3)), tool("−", "zoom out", () => drawing.zoomBy(1 / 1.3)), tool("⤢", "show the whole graph", () => drawing.fit()));
  at("tools").append(tool("?", "keys and help", () => help.showModal()));
  keys({ drawing, source, steps, field, help, choose, selected: () => selection });
  window.matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
    trajectory?.draw();
    drawing.remark();
  });

  facts();
  choose({ cluster: chain ? source.first : source.ids[0] });
  drawing.fit();
  document.body.dataset.ready = String(Math.round(performance.now()));
}

const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };

function keys({ drawing, source, steps, field, help, choose, selected }) {
  document.addEventListener("keydown", (event) => {
    if (!(event.target instanceof Element)) return;
    // Until the next frame a closed dialog keeps the focus.
    const typing = event.target.closest("input, select, textarea, dialog[open]");
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    if (event.key === "Escape") {
      if (help.open) help.close();
      else if (document.activeElement instanceof HTMLElement) document.activeElement.blur();
      return;
    }
    if (typing && !(event.target.type === "range" && ["/", "?", "+", "-", "0"].includes(event.key))) return;
    const focused = event.target.closest("[data-cluster], [data-edge]");
    const done = () => event.preventDefault();
    const now = selected();
    const step = now.cluster ?? now.edge[0];
    if (event.key === "Enter" && focused) {
      done();
      if (focused.dataset.cluster) choose({ cluster: Number(focused.dataset.cluster) });
      else choose({ edge: focused.dataset.edge.split("-").map(Number) });
    } else if (event.key in ARROWS) {
      if (event.target.closest("#inspector") && ARROWS[event.key][1]) return;
      done();
      const next = drawing.towards(step, ...ARROWS[event.key]);
      if (next !== null) choose({ cluster: next });
    } else if (steps && ["PageUp", "PageDown", "Home", "End"].includes(event.key)) {
      done();
      steps.go({ PageUp: step + 10, PageDown: step - 10, Home: source.first, End: source.last }[event.key]);
    } else if (steps && event.key === " " && !event.target.closest("button, summary")) {
      done();
      steps.toggle();
    } else if (event.key === "+" || event.key === "=") {
      drawing.zoomBy(1.3);
    } else if (event.key === "-") {
      drawing.zoomBy(1 / 1.3);
    } else if (event.key === "0") {
      drawing.fit();
    } else if (event.key === "/") {
      done();
      field.focus();
      field.select();
    } else if (event.key === "?") {
      help.showModal();
    }
  });
}

started().catch((error) => {
  document.getElementById("title").textContent = "This page could not be read";
  document.getElementById("facts").textContent = String(error);
  throw error;
});
