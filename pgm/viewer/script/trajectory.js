// The beliefs of a chain over all its steps: in the plane, over time, or as bars of colour.

// A state over time is no taller than this, in pixels.
const TALLEST = 110;

class Trajectory {
  constructor(box, source, choose) {
    this.box = box;
    this.source = source;
    this.choose = choose;
    this.canvas = el("canvas", { role: "img", tabindex: 0 });
    this.select = el("select", { "aria-label": "what is drawn" });
    this.legend = el("ul", { class: "legend" });
    this.options = this.choices();
    this.options.forEach(({ text }, k) => this.select.append(el("option", { value: k }, text)));
    this.select.addEventListener("change", () => {
      this.zoomed = null;
      this.draw();
    });
    this.back = el("button", { type: "button", title: "show all steps", onclick: () => {
      this.zoomed = null;
      this.draw();
    } }, "all");
    box.append(el("div", { class: "choices" }, el("label", {}, "trajectory ", this.select), this.back, this.legend), this.canvas);
    this.step = source.first;
    this.listen();
    new ResizeObserver(() => this.draw()).observe(this.canvas);
  }

  // The ways to draw: two components of a variable, each component over time, states over time.
  choices() {
    const found = [];
    const overTime = [];
    let at = 0;
    for (const variable of this.source.hidden) {
      if (variable.states) {
        overTime.push({ kind: "states", text: `${variable.name} over time`, variable });
        continue;
      }
      const { components } = variable;
      const label = (k) => (components.length === 1 ? variable.name : `${variable.name} ${components[k]}`);
      if (variable.state && components.length > 1) {
        const flat = components.map((_, k) => k).filter((k) => !variable.angles[k]);
        const [a, b] = flat.length > 1 ? flat : [0, 1];
        const wanted = ["x", "y", "east", "north"].map((name) => components.indexOf(name)).filter((k) => k >= 0);
        const [x, y] = wanted.length >= 2 ? wanted : [a, b];
        found.push({ kind: "plane", text: `${variable.name}: ${components[x]}, ${components[y]}`, places: [at + x, at + y], components: [components[x], components[y]], names: [label(x), label(y)], alike: !variable.angles[x] && !variable.angles[y] });
      }
      for (let k = 0; k < components.length; k++) overTime.push({ kind: "time", text: `${label(k)} over time`, place: at + k, name: label(k) });
      at += components.length;
    }
    return [...found, ...overTime];
  }

  get option() {
    return this.options[Number(this.select.value) || 0];
  }

  column(place) {
    return this.source.arrays.mean.column(place);
  }

  // Where the entry of a covariance stands in its packed lower triangle.
  entry(i, j) {
    const [a, b] = i >= j ? [i, j] : [j, i];
    return this.source.arrays.cov.column((a * (a + 1)) / 2 + b);
  }

  get offset() {
    return this.source.first - this.source.base;
  }

  draw() {
    const box = this.canvas.getBoundingClientRect();
    if (box.width < 2 || !this.option) return;
    const ratio = window.devicePixelRatio || 1;
    this.canvas.width = Math.round(box.width * ratio);
    this.canvas.height = Math.round(box.height * ratio);
    this.pen = this.canvas.getContext("2d");
    this.pen.scale(ratio, ratio);
    this.size = { width: box.width, height: box.height };
    this.ink = colours(this.box);
    this.pen.font = `11px ${getComputedStyle(this.box).fontFamily}`;
    this.canvas.setAttribute("aria-label", `${this.option.text}, steps ${this.source.first} to ${this.source.last}; step ${this.step} is marked`);
    this.canvas.dataset.step = this.step;
    if (this.option.kind === "plane") this.plane();
    else if (this.option.kind === "time") this.overTime();
    else this.states();
  }

  frame(x, y, xNames, yNames, least = 36) {
    const pad = { left: 58, right: 16, top: 12, bottom: Math.max(least, 36) };
    const { width, height } = this.size;
    const across = width - pad.left - pad.right;
    const down = height - pad.top - pad.bottom;
    this.at = {
      pad, across, down, limits: [x, y],
      x: (value) => pad.left + (value - x[0]) / (x[1] - x[0]) * across,
      y: (value) => height - pad.bottom - (value - y[0]) / (y[1] - y[0]) * down,
      value: (px, py) => [x[0] + (px - pad.left) / across * (x[1] - x[0]), y[0] + (height - pad.bottom - py) / down * (y[1] - y[0])],
    };
    const { pen, ink } = this;
    pen.clearRect(0, 0, width, height);
    pen.strokeStyle = ink.grid;
    pen.fillStyle = ink.muted;
    pen.lineWidth = 1;
    const xs = ticks(x[0], x[1], Math.max(3, Math.round(across / 90)));
    const ys = yNames === null ? [] : ticks(y[0], y[1], Math.max(3, Math.round(down / 60)));
    pen.beginPath();
    pen.textAlign = "center";
    for (const value of xs) {
      pen.moveTo(this.at.x(value), pad.top);
      pen.lineTo(this.at.x(value), height - pad.bottom);
      pen.fillText(tickText(value, xs[1] - xs[0] || 1), this.at.x(value), height - pad.bottom + 15);
    }
    pen.textAlign = "right";
    for (const value of ys) {
      pen.moveTo(pad.left, this.at.y(value));
      pen.lineTo(width - pad.right, this.at.y(value));
      pen.fillText(tickText(value, ys[1] - ys[0] || 1), pad.left - 7, this.at.y(value) + 4);
    }
    pen.stroke();
    pen.textAlign = "center";
    pen.fillStyle = ink.text;
    pen.fillText(xNames, pad.left + 0.5 * across, height - pad.bottom + 31);
    if (yNames !== null) {
      pen.save();
      pen.translate(13, pad.top + 0.5 * down);
      pen.rotate(-0.5 * Math.PI);
      pen.fillText(yNames, 0, 0);
      pen.restore();
    }
    pen.save();
    pen.beginPath();
    pen.rect(pad.left, pad.top, across, down);
    pen.clip();
  }

  plane() {
    const { places: [a, b], names, alike } = this.option;
    const xs = this.column(a);
    const ys = this.column(b);
    const [vxx, vxy, vyy] = [this.entry(a, a), this.entry(a, b), this.entry(b, b)];
    let limits = this.zoomed ?? [spanOf(xs, vxx), spanOf(ys, vyy)].map((span, k) => this.widened(span, k));
    if (alike) {
      const room = [this.size.width - 74, this.size.height - 48];
      const scale = Math.max(...limits.map(([low, high], k) => (high - low) / room[k]));
      limits = limits.map(([low, high], k) => [0.5 * (low + high - scale * room[k]), 0.5 * (low + high + scale * room[k])]);
    }
    this.frame(...limits, names[0], names[1]);
    const { pen, ink, at } = this;
    const there = this.source.arrays["there.mean"];
    const columns = there ? this.source.stateColumns : [];
    const [fx, fy] = [columns.indexOf(a), columns.indexOf(b)];
    const filtered = fx >= 0 && fy >= 0;
    if (filtered) this.line(there.column(fx), there.column(fy), ink.first, [4, 3], 1);
    const draws = this.source.arrays.draws;
    if (draws) this.cloud(draws, a, b);
    const seen = this.landmarks();
    // Ellipses of some steps over the whole, and of those about the selected one.
    const every = Math.max(1, Math.round((this.source.last - this.source.first) / 36));
    const show = (step, strong) => {
      const k = step - this.source.base;
      const { long, short: narrow, angle } = ellipseOf(vxx[k], vxy[k], vyy[k]);
      const scale = [at.across / (limits[0][1] - limits[0][0]), at.down / (limits[1][1] - limits[1][0])];
      pen.beginPath();
      for (let n = 0; n <= 40; n++) {
        const turn = (2 * Math.PI * n) / 40;
        const [p, q] = [long * Math.cos(turn), narrow * Math.sin(turn)];
        pen.lineTo(at.x(xs[k]) + scale[0] * (p * Math.cos(angle) - q * Math.sin(angle)), at.y(ys[k]) - scale[1] * (p * Math.sin(angle) + q * Math.cos(angle)));
      }
      pen.globalAlpha = strong ? 1 : 0.35;
      pen.strokeStyle = ink.text;
      pen.fillStyle = ink.soft;
      pen.lineWidth = strong ? 1.6 : 0.8;
      if (strong) pen.fill();
      pen.stroke();
      pen.globalAlpha = 1;
    };
    for (let step = this.source.first; step <= this.source.last; step += every) show(step, false);
    this.line(xs, ys, ink.text, [], 1.6);
    for (let step = this.step - 2; step <= this.step + 2; step++) {
      if (step !== this.step && step >= this.source.first && step <= this.source.last) show(step, false);
    }
    show(this.step, true);
    this.mark(at.x(xs[this.step - this.source.base]), at.y(ys[this.step - this.source.base]));
    pen.restore();
    this.explain([["belief", String(this.source.data.about)], ...(filtered ? [["first", "filtered"]] : []), ...(draws ? [["cloud", "draws"]] : []), ...(seen ? [["third", "sighted at this step"]] : [])]);
  }

  // A span with the places of what was seen, where they are not much further away.
  widened([low, high], k) {
    const found = [low, high];
    for (const { given } of this.source.sensors) {
      for (const { components, rows } of given) {
        const place = components.indexOf(this.option.components[k]);
        if (place < 0) continue;
        for (const value of rows.column(place)) {
          if (value > low - 1.5 * (high - low)) found[0] = Math.min(found[0], value - 0.04 * (high - low));
          if (value < high + 1.5 * (high - low)) found[1] = Math.max(found[1], value + 0.04 * (high - low));
        }
      }
    }
    return found;
  }

  // What sensors saw, where its place was given in the components that are drawn.
  landmarks() {
    const { pen, at, ink } = this;
    let any = false;
    for (const { given, step } of this.source.sensors) {
      for (const { components, rows } of given) {
        const places = this.option.components.map((name) => components.indexOf(name));
        if (places.some((k) => k < 0)) continue;
        any = true;
        const drawn = new Set();
        const k = this.step - this.source.base;
        const [x, y] = this.option.places.map((place) => at[place === this.option.places[0] ? "x" : "y"](this.column(place)[k]));
        for (let row = 0; row < step.length; row++) {
          const [px, py] = [at.x(rows.at(row, places[0])), at.y(rows.at(row, places[1]))];
          const key = `${px.toFixed(1)} ${py.toFixed(1)}`;
          if (!drawn.has(key)) {
            drawn.add(key);
            pen.strokeStyle = ink.muted;
            pen.lineWidth = 1.4;
            pen.strokeRect(px - 3, py - 3, 6, 6);
          }
          if (step[row] === this.step) {
            pen.strokeStyle = ink.third;
            pen.setLineDash([8, 3, 2, 3]);
            pen.beginPath();
            pen.moveTo(x, y);
            pen.lineTo(px, py);
            pen.stroke();
            pen.setLineDash([]);
          }
        }
      }
    }
    return any;
  }

  // Draws of the belief at the selected step.
  cloud(draws, a, b) {
    const row = draws.row(this.step - this.source.base);
    const size = this.source.hidden[0].components.length;
    const { pen, at, ink } = this;
    if (a >= size || b >= size) return;
    pen.fillStyle = ink.second;
    for (let k = 0; k < row.length; k += size) {
      pen.beginPath();
      pen.arc(at.x(row[k + a]), at.y(row[k + b]), 1.8, 0, 7);
      pen.fill();
    }
  }

  line(xs, ys, colour, dash, width) {
    const { pen, at } = this;
    pen.beginPath();
    for (let k = this.offset; k < xs.length; k++) pen.lineTo(at.x(xs[k]), at.y(ys[k]));
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.setLineDash(dash);
    pen.lineJoin = "round";
    pen.stroke();
    pen.setLineDash([]);
  }

  mark(x, y) {
    const { pen, ink } = this;
    this.canvas.dataset.x = x.toFixed(1);
    this.canvas.dataset.y = y.toFixed(1);
    pen.beginPath();
    pen.arc(x, y, 5, 0, 7);
    pen.fillStyle = ink.second;
    pen.fill();
    pen.lineWidth = 2;
    pen.strokeStyle = ink.paper;
    pen.stroke();
  }

  get steps() {
    const { first, last } = this.source;
    return this.zoomed?.[0] ?? (first < last ? [first, last] : [first - 1, last + 1]);
  }

  overTime() {
    const { place, name } = this.option;
    const values = this.column(place);
    const variance = this.entry(place, place);
    const x = this.steps;
    const there = this.source.arrays["there.mean"];
    const own = there ? this.source.stateColumns.indexOf(place) : -1;
    const limits = spanOf(values, variance);
    if (own >= 0) {
      const other = spanOf(there.column(own), new Float64Array(values.length));
      limits[0] = Math.min(limits[0], other[0]);
      limits[1] = Math.max(limits[1], other[1]);
    }
    this.frame(x, this.zoomed?.[1] ?? limits, "step", name);
    const { pen, at, ink } = this;
    const { base } = this.source;
    const from = Math.max(Math.floor(x[0]), this.source.first);
    const to = Math.min(Math.ceil(x[1]), this.source.last);
    const edge = (sign, k) => values[k - base] + sign * 1.96 * Math.sqrt(Math.max(variance[k - base], 0));
    pen.beginPath();
    for (let k = from; k <= to; k++) if (!Number.isNaN(values[k - base])) pen.lineTo(at.x(k), at.y(edge(1, k)));
    for (let k = to; k >= from; k--) if (!Number.isNaN(values[k - base])) pen.lineTo(at.x(k), at.y(edge(-1, k)));
    pen.fillStyle = ink.soft;
    pen.fill();
    const steps = Float64Array.from(values, (_, k) => k + base);
    if (own >= 0) this.line(steps, there.column(own), ink.first, [4, 3], 1);
    this.line(steps, values, ink.text, [], 1.6);
    pen.strokeStyle = ink.second;
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(at.x(this.step), at.pad.top);
    pen.lineTo(at.x(this.step), at.pad.top + at.down);
    pen.stroke();
    const value = values[this.step - base];
    if (!Number.isNaN(value)) this.mark(at.x(this.step), at.y(value));
    pen.restore();
    this.explain([["belief", `${this.source.data.about}, 95 %`], ...(own >= 0 ? [["first", "filtered"]] : [])]);
  }

  // The probability of each state at each step, darker where it is larger.
  states() {
    const { variable } = this.option;
    const count = variable.states.length;
    const x = this.steps;
    // A few states do not need all of the height.
    const room = this.size.height - 12 - TALLEST * count;
    this.frame([x[0] - 0.5, x[1] + 0.5], [0, count], "step", null, room);
    this.pen.clearRect(this.at.pad.left, this.at.pad.top, this.at.across, this.at.down);
    const { pen, at, ink } = this;
    const { first, last } = this.source;
    const [from, to] = [Math.max(first, Math.floor(x[0])), Math.min(last, Math.ceil(x[1]))];
    const every = Math.max(1, Math.floor((to - from + 1) / Math.max(at.across, 1)));
    const wide = at.x(every) - at.x(0);
    const tall = at.down / count;
    pen.fillStyle = ink.first;
    for (let step = from; step <= to; step += every) {
      const values = this.source.stateProbabilities(step, variable.name);
      if (!values) continue;
      for (let k = 0; k < count; k++) {
        pen.globalAlpha = values[k];
        pen.fillRect(at.x(step - 0.5), at.pad.top + k * tall + 1, wide + 0.5, Math.max(tall - 2, 1));
      }
    }
    pen.globalAlpha = 1;
    pen.strokeStyle = ink.second;
    pen.lineWidth = 2;
    pen.strokeRect(at.x(this.step - 0.5), at.pad.top + 1, Math.max(at.x(1) - at.x(0), 3), at.down - 2);
    this.canvas.dataset.x = at.x(this.step).toFixed(1);
    this.canvas.dataset.y = (at.pad.top + 0.5 * at.down).toFixed(1);
    pen.restore();
    pen.fillStyle = ink.muted;
    pen.textAlign = "right";
    const skip = Math.max(1, Math.ceil(count / (at.down / 14)));
    for (let k = 0; k < count; k += skip) pen.fillText(clipped(variable.states[k], 8), at.pad.left - 7, at.pad.top + (k + 0.5) * tall + 4);
    this.explain([[null, `${this.source.data.about}: the stronger, the more probable`]]);
  }

  explain(items) {
    this.legend.replaceChildren(...items.map(([role, text]) => el("li", {}, role && sample(role), text)));
  }

  // The step whose belief is nearest to a place on the canvas.
  nearest(px, py) {
    const { first, last, base } = this.source;
    const clip = (step) => Math.min(Math.max(Math.round(step), first), last);
    if (this.option.kind !== "plane") return clip(this.at.value(px, py)[0]);
    const { places: [a, b] } = this.option;
    const [xs, ys] = [this.column(a), this.column(b)];
    let best = first;
    let least = Infinity;
    for (let step = first; step <= last; step++) {
      const far = Math.hypot(this.at.x(xs[step - base]) - px, this.at.y(ys[step - base]) - py);
      if (far < least) [least, best] = [far, step];
    }
    return best;
  }

  listen() {
    let from = null;
    let moved = false;
    const where = (event) => {
      const box = this.canvas.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    this.canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      const [px, py] = where(event);
      const centre = this.at.value(px, py);
      const factor = Math.exp(0.0015 * event.deltaY);
      this.zoomed = this.at.limits.map(([low, high], k) => [centre[k] + factor * (low - centre[k]), centre[k] + factor * (high - centre[k])]);
      this.draw();
    }, { passive: false });
    this.canvas.addEventListener("pointerdown", (event) => {
      from = { at: where(event), limits: this.at.limits };
      moved = false;
    });
    this.canvas.addEventListener("pointermove", (event) => {
      if (!from) return;
      const [px, py] = where(event);
      if (!moved && Math.hypot(px - from.at[0], py - from.at[1]) < 4) return;
      if (!moved) this.canvas.setPointerCapture(event.pointerId);
      moved = true;
      const [[x0, x1], [y0, y1]] = from.limits;
      const dx = (px - from.at[0]) / this.at.across * (x1 - x0);
      const dy = (py - from.at[1]) / this.at.down * (y1 - y0);
      this.zoomed = [[x0 - dx, x1 - dx], [y0 + dy, y1 + dy]];
      this.draw();
    });
    this.canvas.addEventListener("pointerup", (event) => {
      if (from && !moved) this.choose({ cluster: this.nearest(...where(event)) });
      from = null;
    });
    this.canvas.addEventListener("pointercancel", () => {
      from = null;
    });
  }

  show(step) {
    this.step = step;
    this.draw();
  }
}

// The range of means and their deviations.
function spanOf(values, variances) {
  let low = Infinity;
  let high = -Infinity;
  for (let k = 0; k < values.length; k++) {
    const std = Math.sqrt(Math.max(variances[k], 0));
    if (!Number.isFinite(values[k] + std)) continue;
    low = Math.min(low, values[k] - 2.5 * std);
    high = Math.max(high, values[k] + 2.5 * std);
  }
  if (!(low < high)) return Number.isFinite(low) ? [low - 1, low + 1] : [0, 1];
  const pad = 0.04 * (high - low);
  return [low - pad, high + pad];
}

function colours(node) {
  const style = getComputedStyle(node);
  const of = (name) => style.getPropertyValue(`--${name}`).trim();
  return { text: of("belief"), muted: of("muted"), grid: of("grid"), first: of("first"), second: of("second"), third: of("third"), soft: of("soft"), paper: of("paper") };
}
