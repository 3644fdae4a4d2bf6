// The beliefs of a chain over all its steps: in the plane, over time, or as bars of colour.

// A state over time is no taller than this, in pixels.
const TALLEST = 110;

class Trajectory extends Plot {
  constructor(box, source, choose) {
    super(el("canvas", { role: "img", tabindex: 0 }));
    this.source = source;
    this.choose = choose;
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
  }

  // The ways to draw: the places of a variable, each component and states over time, controls after
  // states; and last two components that are no place, one against the other.
  choices() {
    const places = [];
    const overTime = [];
    const phases = [];
    let at = 0;
    for (const variable of this.source.hidden) {
      if (variable.states) {
        overTime.push({ kind: "states", state: variable.state, text: `${variable.name} over time`, variable });
        continue;
      }
      const { components } = variable;
      const label = (k) => (components.length === 1 ? variable.name : `${variable.name} ${components[k]}`);
      if (variable.state && components.length > 1) {
        const place = placeOf(variable);
        const [x, y] = place ?? [0, 1];
        (place ? places : phases).push({ kind: "plane", text: `${variable.name}: ${components[x]}, ${components[y]}`, variable: variable.name, own: [x, y], places: [at + x, at + y], components: [components[x], components[y]], names: [label(x), label(y)], alike: Boolean(place) });
      }
      for (let k = 0; k < components.length; k++) overTime.push({ kind: "time", state: variable.state, text: `${label(k)} over time`, variable: variable.name, own: k, place: at + k, name: label(k) });
      at += components.length;
    }
    overTime.sort((a, b) => Number(b.state) - Number(a.state));
    return [...places, ...overTime, ...phases];
  }

  // The true values of a component of what is drawn, at each step of the arrays; null of none.
  truth(component) {
    return this.source.true.get(this.option.variable)?.column(component) ?? null;
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

  // The steps of the arrays at which the belief was lost, where the page knows: NaN elsewhere.
  lost(values) {
    const { lost } = this.source.data.runs[this.source.run];
    if (!lost?.length) return null;
    return values.map((value, k) => (lost.some(([first, last]) => k + this.source.base >= first && k + this.source.base <= last) ? value : NaN));
  }

  get offset() {
    return this.source.first - this.source.base;
  }

  drawn() {
    this.canvas.setAttribute("aria-label", `${this.option.text}, steps ${this.source.first} to ${this.source.last}; step ${this.step} is marked`);
    this.canvas.dataset.step = this.step;
    if (this.option.kind === "plane") this.plane();
    else if (this.option.kind === "time") this.overTime();
    else this.states();
  }

  plane() {
    const { places: [a, b], names, alike } = this.option;
    const xs = this.column(a);
    const ys = this.column(b);
    const [vxx, vxy, vyy] = [this.entry(a, a), this.entry(a, b), this.entry(b, b)];
    let limits = this.zoomed ?? [spanOf(xs, vxx), spanOf(ys, vyy)].map((span, k) => this.widened(spanned(span, this.truth(this.option.own[k])), k));
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
    const [tx, ty] = this.option.own.map((k) => this.truth(k));
    if (filtered) this.line(there.column(fx), there.column(fy), ink.first, [4, 3], 1, this.offset);
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
    this.line(xs, ys, ink.text, [], 1.6, this.offset);
    if (tx) this.line(tx, ty, ink.fourth, [], 1.4, this.offset);
    const lost = this.lost(xs);
    if (lost) this.line(lost, ys, ink.second, [], 4, this.offset);
    for (let step = this.step - 2; step <= this.step + 2; step++) {
      if (step !== this.step && step >= this.source.first && step <= this.source.last) show(step, false);
    }
    show(this.step, true);
    this.mark(at.x(xs[this.step - this.source.base]), at.y(ys[this.step - this.source.base]));
    pen.restore();
    this.explain([["belief", String(this.source.data.about)], ...(filtered ? [["first", "filtered"]] : []), ...(tx ? [["truth", "truth"]] : []), ...(lost ? [["lost", "lost"]] : []), ...(draws ? [["cloud", "draws"]] : []), ...(seen ? [["third", "sighted at this step"]] : [])]);
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
    const truth = this.truth(this.option.own);
    let limits = spanned(spanOf(values, variance), truth);
    if (own >= 0) limits = spanned(limits, there.column(own));
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
    if (own >= 0) this.line(steps, there.column(own), ink.first, [4, 3], 1, this.offset);
    this.line(steps, values, ink.text, [], 1.6, this.offset);
    if (truth) this.line(steps, truth, ink.fourth, [], 1.4, this.offset);
    const lost = this.lost(values);
    if (lost) this.line(steps, lost, ink.second, [], 4, this.offset);
    pen.strokeStyle = ink.second;
    pen.lineWidth = 1;
    pen.beginPath();
    pen.moveTo(at.x(this.step), at.pad.top);
    pen.lineTo(at.x(this.step), at.pad.top + at.down);
    pen.stroke();
    const value = values[this.step - base];
    if (!Number.isNaN(value)) this.mark(at.x(this.step), at.y(value));
    pen.restore();
    this.explain([["belief", `${this.source.data.about}, 95 %`], ...(own >= 0 ? [["first", "filtered"]] : []), ...(truth ? [["truth", "truth"]] : []), ...(lost ? [["lost", "lost"]] : [])]);
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
    const truth = this.source.true.get(variable.name)?.column(0);
    pen.strokeStyle = ink.fourth;
    pen.lineWidth = 2;
    for (let step = from; truth && step <= to; step += every) {
      const state = truth[step - this.source.base];
      if (!Number.isFinite(state)) continue;
      const y = at.pad.top + (state + 0.5) * tall;
      pen.beginPath();
      pen.moveTo(at.x(step - 0.5), y);
      pen.lineTo(at.x(step - 0.5) + wide, y);
      pen.stroke();
    }
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
    this.explain([[null, `${this.source.data.about}: the stronger, the more probable`], ...(truth ? [["truth", "truth"]] : [])]);
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

  clicked(px, py) {
    this.choose({ cluster: this.nearest(px, py) });
  }

  show(step) {
    this.step = step;
    this.draw();
  }
}

// The two components in which a variable is a place: named as such, lengths of one unit, or what a
// pose has beside its angle; null of one that is no place, as a level and its trend.
const PLANES = [["x", "y"], ["east", "north"], ["px", "py"], ["e", "n"]];
const LENGTHS = ["mm", "cm", "m", "km", "ft"];

function placeOf({ components, angles, units }) {
  for (const names of PLANES) {
    const found = names.map((name) => components.indexOf(name));
    if (found.every((k) => k >= 0)) return found;
  }
  const flat = components.map((_, k) => k).filter((k) => !angles[k]);
  if (flat.length === 2 && angles.length === 3) return flat;
  const lengths = flat.filter((k) => LENGTHS.includes(units[k]));
  return lengths.length > 1 && units[lengths[0]] === units[lengths[1]] ? lengths.slice(0, 2) : null;
}

// A span that holds other values, too.
function spanned([low, high], values) {
  if (!values) return [low, high];
  const other = spanOf(values, new Float64Array(values.length));
  return values.some(Number.isFinite) ? [Math.min(low, other[0]), Math.max(high, other[1])] : [low, high];
}
