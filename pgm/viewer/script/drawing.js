// The cluster graph: clusters as rounded shapes, sepsets as rectangles; panned, zoomed, clicked.

// From this zoom on all is written: names, numbers of clusters, sepsets. Below it names alone, in
// letters that stay so many pixels tall, and none where these would be taller than that share of a
// cluster.
const NEAR = 0.8;
const LETTERS = 12;
const LEAST = 10;
const TALL = 0.75;
// Names of the lines in which messages are drawn; more than these share the last.
const LINES = ["first", "second", "third", "fourth"];

// On a chain the way of a message tells its line, else the order of its sender.
function lineOf(source, sender, receiver) {
  if (source instanceof ChainSource) return Number(sender > receiver);
  return Math.min(source.senders(receiver).indexOf(sender), LINES.length - 1);
}

class Drawing {
  constructor(svgElement, source, { curved, choose }) {
    this.svg = svgElement;
    this.source = source;
    this.curved = curved;
    this.choose = choose;
    this.nodes = new Map();
    this.wires = new Map();
    this.selected = null;
    this.residuals = null;
    this.view = { x: 0, y: 0, zoom: 1 };
    this.letters = LETTERS;
    this.edgeLayer = svg("g", { class: "edges" });
    this.nodeLayer = svg("g", { class: "nodes" });
    this.world = svg("g", {}, this.edgeLayer, this.nodeLayer);
    this.svg.append(this.world);
    this.tip = el("div", { id: "tip", "aria-hidden": "true", hidden: true });
    this.svg.after(this.tip);
    this.listen();
    new ResizeObserver(() => this.resized()).observe(this.svg);
  }

  get size() {
    const box = this.svg.getBoundingClientRect();
    return { width: Math.max(box.width, 1), height: Math.max(box.height, 1) };
  }

  resized() {
    if (this.svg.getBoundingClientRect().width < 2) return;
    if (!this.fitted) this.fit();
    else this.render();
  }

  // All of a graph; of a chain the clusters about the one that is selected.
  fit() {
    const { width, height } = this.size;
    const box = this.source.bounds();
    const across = box.right - box.left;
    const down = box.bottom - box.top;
    let zoom = Math.min((width - 56) / across, (height - 48) / down, 1.15);
    if (this.source instanceof ChainSource) zoom = Math.max(zoom, 0.92);
    this.least = Math.min(zoom, this.source instanceof ChainSource ? width / (60 * this.source.across) : zoom) * 0.8;
    this.view = { zoom, x: 0.5 * (box.left + box.right), y: 0.5 * (box.top + box.bottom) };
    this.fitted = true;
    if (this.source instanceof ChainSource && width / zoom < across) this.centre(this.selected?.id ?? this.source.first);
    this.render();
  }

  centre(id) {
    const node = this.source.node(id);
    if (!node) return;
    this.view.x = node.x;
    if (!(this.source instanceof ChainSource)) this.view.y = node.y;
    this.render();
  }

  // Near enough to read labels.
  approach(id) {
    if (this.view.zoom < NEAR) {
      this.view.zoom = 0.85;
      this.centre(id);
    }
  }

  // Move the view so that a cluster is well inside.
  reveal(id) {
    const node = this.source.node(id);
    if (!node || !this.fitted) return;
    const box = this.box();
    const beside = 0.5 * node.width + 30;
    const above = this.source instanceof ChainSource ? 0 : this.source.height;
    if (node.x < box.left + beside || node.x > box.right - beside
      || node.y < box.top + above || node.y > box.bottom - above) this.centre(id);
  }

  zoomBy(factor, at = null) {
    const { width, height } = this.size;
    const { x, y, zoom } = this.view;
    const next = Math.min(Math.max(zoom * factor, this.least ?? 0.02), 3);
    const [dx, dy] = at ?? [0.5 * width, 0.5 * height];
    const shift = 1 / zoom - 1 / next;
    this.view = { zoom: next, x: x + (dx - 0.5 * width) * shift, y: y + (dy - 0.5 * height) * shift };
    this.render();
  }

  // The part of the graph that is seen, and a margin.
  box(margin = 0) {
    const { width, height } = this.size;
    const { x, y, zoom } = this.view;
    const across = 0.5 * width / zoom + margin;
    const down = 0.5 * height / zoom + margin;
    return { left: x - across, right: x + across, top: y - down, bottom: y + down };
  }

  listen() {
    let from = null;
    let moved = false;
    this.svg.addEventListener("wheel", (event) => {
      event.preventDefault();
      if (Math.abs(event.deltaX) > Math.abs(event.deltaY)) {
        this.view.x += event.deltaX / this.view.zoom;
        this.render();
        return;
      }
      const box = this.svg.getBoundingClientRect();
      this.zoomBy(Math.exp(-0.0015 * event.deltaY), [event.clientX - box.left, event.clientY - box.top]);
    }, { passive: false });
    this.svg.addEventListener("pointerdown", (event) => {
      if (event.button !== 0) return;
      from = { x: event.clientX, y: event.clientY, view: { ...this.view }, id: event.pointerId };
      moved = false;
    });
    this.svg.addEventListener("pointermove", (event) => {
      if (!from || event.pointerId !== from.id) return;
      const dx = event.clientX - from.x;
      const dy = event.clientY - from.y;
      if (!moved && Math.hypot(dx, dy) < 4) return;
      if (!moved) this.svg.setPointerCapture(from.id);
      moved = true;
      this.svg.classList.add("dragged");
      this.view.x = from.view.x - dx / this.view.zoom;
      if (!(this.source instanceof ChainSource)) this.view.y = from.view.y - dy / this.view.zoom;
      this.render();
    });
    // What is under the cursor is told beside it at once, however small it is drawn.
    this.svg.addEventListener("pointermove", (event) => {
      const under = event.target.closest("[data-cluster], [data-edge]");
      this.tip.hidden = !under || moved;
      if (!under) return;
      const box = this.svg.getBoundingClientRect();
      const [x, y] = [event.clientX - box.left, event.clientY - box.top];
      this.tip.textContent = under.getAttribute("aria-label");
      this.tip.style.left = `${Math.max(8, Math.min(x + 12, box.width - this.tip.offsetWidth - 8))}px`;
      this.tip.style.top = `${y + 20 + this.tip.offsetHeight > box.height ? y - this.tip.offsetHeight - 10 : y + 20}px`;
    });
    this.svg.addEventListener("pointerleave", () => {
      this.tip.hidden = true;
    });
    const ended = () => {
      from = null;
      this.svg.classList.remove("dragged");
    };
    this.svg.addEventListener("pointerup", ended);
    this.svg.addEventListener("pointercancel", ended);
    this.svg.addEventListener("click", (event) => {
      if (moved) {
        moved = false;
        return;
      }
      const node = event.target.closest("[data-cluster]");
      const edge = event.target.closest("[data-edge]");
      if (node) this.choose({ cluster: Number(node.dataset.cluster) });
      else if (edge) this.choose({ edge: edge.dataset.edge.split("-").map(Number) });
    });
  }

  // Chains stay in the middle, and leave no room empty before or after them.
  clamp() {
    if (!(this.source instanceof ChainSource)) return;
    const box = this.source.bounds();
    const half = 0.5 * this.size.width / this.view.zoom - 24;
    const [low, high] = [box.left + half, box.right - half];
    this.view.x = low > high ? 0.5 * (box.left + box.right) : Math.min(Math.max(this.view.x, low), high);
    this.view.y = 0.5 * (box.top + box.bottom);
  }

  render() {
    if (!this.fitted) return;
    this.clamp();
    const { width, height } = this.size;
    const { x, y, zoom } = this.view;
    const shift = `translate(${0.5 * width - x * zoom} ${0.5 * height - y * zoom}) scale(${zoom})`;
    this.world.setAttribute("transform", shift);
    this.write(zoom);
    const box = this.box(80);
    this.keep(this.edgeLayer, this.wires, this.source.edgesIn(box).map((e) => [e.id, e]), (e) => this.drawnEdge(e));
    this.keep(this.nodeLayer, this.nodes, this.source.nodesIn(box).map((id) => [id, id]), (id) => this.drawnNode(id));
  }

  // Letters as large as a zoom needs them, in steps, so that few zooms write everything anew.
  write(zoom) {
    const letters = zoom >= NEAR ? LETTERS : LETTERS * 1.15 ** Math.ceil(Math.log(LEAST / (LETTERS * zoom)) / Math.log(1.15));
    this.svg.classList.toggle("near", zoom >= NEAR);
    this.svg.classList.toggle("far", letters > TALL * this.source.height);
    if (letters === this.letters) return;
    this.letters = letters;
    this.clear(this.nodes);
  }

  clear(drawn) {
    for (const element of drawn.values()) element.remove();
    drawn.clear();
  }

  // Draw what has come into view, and remove what has left it.
  keep(layer, drawn, wanted, make) {
    const due = new Set(wanted.map(([key]) => key));
    for (const [key, element] of drawn) {
      if (!due.has(key)) {
        element.remove();
        drawn.delete(key);
      }
    }
    for (const [key, given] of wanted) {
      if (drawn.has(key)) continue;
      const element = make(given);
      drawn.set(key, element);
      layer.append(element);
    }
  }

  drawnNode(id) {
    const node = this.source.node(id);
    const height = this.source.height;
    const half = 0.5 * height;
    const text = (y, name, content) => svg("text", { y, class: name }, content);
    const near = this.letters === LETTERS;
    const room = this.letters <= TALL * height;
    const label = room ? fittedNames(node.names, node.width - (near ? 14 : 4), this.letters) : "";
    const below = node.note === undefined ? half - 11 : 5;
    const kinds = ["node", node.touched && "touched", node.evidence && "evidence"].filter(Boolean);
    const group = svg("g", {
      class: kinds.join(" "), "data-cluster": id, transform: `translate(${node.x} ${node.y})`,
      role: "button", "aria-label": this.told(id),
    },
    svg("rect", {
      x: -0.5 * node.width, y: -half, width: node.width, height, rx: Math.min(half, 22),
    }),
    near ? text(-half + 14, "tag", node.touched ? `${id} touched` : id) : null,
    label ? text(near ? below : 0.35 * this.letters, "label", label) : null,
    near && node.note ? text(half - 8, "note", node.note) : null);
    group.querySelector(".label")?.style.setProperty("font-size", `${this.letters}px`);
    const [most] = this.source.moved(id);
    if (most) {
      group.classList.add("moved");
      group.style.setProperty("--share", `${Math.round(100 * movedShare(most[1]))}%`);
    }
    this.chosen(group, this.selected?.id === id);
    return group;
  }

  // A cluster in words: its variables, what it reads, how far evidence moved it.
  told(id) {
    const { variables, observed } = this.source.about(id);
    const { note, touched } = this.source.node(id);
    const [most] = this.source.moved(id);
    const parts = [`cluster ${id}: ${variables.join(", ") || "nothing hidden"}`];
    if (note) parts.push(`reads ${note}`);
    else if (observed.length) parts.push(`observed: ${observed.join(", ")}`);
    if (touched) parts.push("touched");
    if (most) parts.push(`evidence moved ${most[0]} by ${short(most[1])} nats`);
    return parts.map((part) => clipped(part, 400)).join("; ");
  }

  // What is selected, and its edges, are reached by Tab.
  chosen(group, yes, near = yes) {
    group.classList.toggle("selected", yes);
    group.setAttribute("tabindex", near ? "0" : "-1");
  }

  drawnEdge(edge) {
    const [i, j] = edge.ends;
    const a = this.source.node(i);
    const b = this.source.node(j);
    const route = this.route(a, b);
    const wide = Math.max(24, 14 + measured(edge.label, 11));
    const group = svg("g", {
      class: "edge", "data-edge": edge.id, role: "button",
      "aria-label": `messages between clusters ${i} and ${j}, over ${edge.names.join(", ")}`,
    },
    svg("path", { class: "hit", d: route.path }),
    svg("path", { class: "wire", d: route.path }),
    svg("g", { class: "plate", transform: `translate(${route.x} ${route.y})` },
      svg("rect", { x: -0.5 * wide, y: -10, width: wide, height: 20, rx: 2 }),
      svg("text", { y: 4 }, edge.label),
      arrow("there", route.angle, -18), arrow("back", route.angle + Math.PI, -18)));
    this.marked(group, edge);
    return group;
  }

  route(a, b) {
    const [left, right] = a.x <= b.x ? [a, b] : [b, a];
    const start = left.x + 0.5 * left.width;
    const end = right.x - 0.5 * right.width;
    const turned = a.x <= b.x ? 0 : Math.PI;
    if (this.curved && end > start) {
      const middle = 0.5 * (start + end);
      const path = `M${start} ${left.y}C${middle} ${left.y} ${middle} ${right.y} ${end} ${right.y}`;
      // In trees nearer to the child, where curves have parted.
      const t = right.towards === left.id ? 0.7 : left.towards === right.id ? 0.3 : 0.5;
      const [p, q, r, s] = [(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t ** 3];
      return {
        path, x: (p * start) + (q + r) * middle + s * end, y: (p + q) * left.y + (r + s) * right.y, angle: turned,
      };
    }
    // Between the borders of the two shapes.
    const dx = b.x - a.x;
    const dy = b.y - a.y;
    const share = (node) => Math.min(
      0.5, 0.5 * node.width / Math.max(Math.abs(dx), 1e-6), 0.5 * this.source.height / Math.max(Math.abs(dy), 1e-6));
    const at = 0.5 * (share(a) + 1 - share(b));
    const path = `M${a.x} ${a.y}L${b.x} ${b.y}`;
    return { path, x: a.x + at * dx, y: a.y + at * dy, angle: Math.abs(dx) >= Math.abs(dy) ? turned : Math.sign(dy) * 0.5 * Math.PI };
  }

  // The state of an edge: how much its messages still change, and which go to what is selected.
  marked(group, edge) {
    const id = this.selected?.id;
    const [i, j] = edge.ends;
    const own = edge.id === this.selected?.edge;
    this.chosen(group, own, own || i === id || j === id);
    group.classList.toggle("to", j === id);
    group.classList.toggle("from", i === id);
    const value = this.residuals ? this.residuals[edge.place] : null;
    // Arrows of what is selected have the lines of their messages in the panel.
    const [there, back] = group.querySelectorAll(".arrow");
    const line = (sender, receiver) => (receiver === id ? LINES[lineOf(this.source, sender, id)] : null);
    there.setAttribute("class", `arrow there ${line(i, j) ?? "first"}`);
    back.setAttribute("class", `arrow back ${line(j, i) ?? "second"}`);
    const wire = group.querySelector(".wire");
    wire.style.stroke = value === null ? "" : residualColour(value);
    wire.style.strokeWidth = value === null ? "" : String(1.5 + 4 * residualShare(value));
    if (value !== null) group.dataset.residual = String(value);
  }

  select({ cluster = null, edge = null }) {
    this.selected = cluster === null ? { edge: `${Math.min(...edge)}-${Math.max(...edge)}` } : { id: cluster };
    for (const [id, group] of this.nodes) this.chosen(group, id === this.selected.id);
    this.remark();
    const shownOne = cluster ?? edge[0];
    this.reveal(shownOne);
  }

  remark() {
    for (const [id, group] of this.wires) {
      this.marked(group, this.source.edge(...id.split("-").map(Number)));
    }
  }

  showResiduals(values) {
    this.residuals = values;
    this.remark();
  }

  // Draw everything anew, as for another run.
  redraw() {
    this.clear(this.nodes);
    this.clear(this.wires);
    this.render();
  }

  // The neighbour that lies most in a direction; null where there is none.
  towards(id, dx, dy) {
    const here = this.source.node(id);
    let best = null;
    let least = Infinity;
    for (const other of this.source.neighbours(id)) {
      const node = this.source.node(other);
      const along = dx * (node.x - here.x) + dy * (node.y - here.y);
      const aside = Math.abs(dy * (node.x - here.x)) + Math.abs(dx * (node.y - here.y));
      if (along > 1e-6 && aside / along + 1e-4 * along < least) {
        least = aside / along + 1e-4 * along;
        best = other;
      }
    }
    return best;
  }
}

function arrow(name, angle, aside) {
  const turn = `rotate(${angle * 180 / Math.PI}) translate(0 ${aside})`;
  return svg("path", { class: `arrow ${name}`, transform: turn, d: "M-13 0H10M5 -3.5L11 0L5 3.5" });
}

// Residuals from 1e-8 to 1 on a scale of decades, from blue over grey to yellow (cividis).
const DECADES = 8;
const CIVIDIS = [[0, 52, 110], [62, 76, 109], [107, 108, 115], [146, 141, 118], [196, 178, 99], [253, 231, 55]];
// On a dark page its dark end is lighter.
const ON_DARK = [[58, 108, 182], [92, 118, 160], [124, 132, 146], [156, 153, 126], [204, 186, 98], [253, 231, 55]];
const dark = window.matchMedia("(prefers-color-scheme: dark)");

// Evidence that moved a belief by 0.001 nats or less is not seen, by 1 or more in full colour.
function movedShare(nats) {
  return Math.min(Math.max(1 + Math.log10(nats) / 3, 0), 1);
}

function residualShare(value) {
  if (!(value > 0)) return 0;
  return Math.min(Math.max(1 + Math.log10(value) / DECADES, 0), 1);
}

function residualColour(value) {
  const scale = dark.matches ? ON_DARK : CIVIDIS;
  const at = residualShare(value) * (scale.length - 1);
  const k = Math.min(Math.floor(at), scale.length - 2);
  const mixed = scale[k].map((low, c) => Math.round(low + (at - k) * (scale[k + 1][c] - low)));
  return `rgb(${mixed.join(",")})`;
}
