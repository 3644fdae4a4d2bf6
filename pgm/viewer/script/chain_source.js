// A chain of slices: clusters and factors are made for a step when they are asked for.

class ChainSource {
  constructor(data, numbers) {
    this.data = data;
    this.numbers = numbers;
    this.family = data.family;
    this.first = data.steps.first;
    this.last = data.steps.last;
    this.base = data.steps.base;
    this.height = 54;
    this.hidden = data.variables;
    this.states = data.variables.filter((variable) => variable.state);
    this.run = 0;
    const some = [this.first, Math.min(this.first + 1, this.last), this.last];
    this.width = Math.max(72, 24 + Math.max(...some.map((step) => measured(listedNames(this.names(step), 28)))));
    const names = this.at(this.states, this.last).map((v) => v.name);
    this.plate = 16 + measured(listedNames(names, 18), 11);
    this.across = this.width + this.plate + 32;
  }

  set run(run) {
    this.place = run;
    const own = this.data.runs[run];
    this.arrays = {};
    for (const [name, ref] of Object.entries(own.arrays)) {
      this.arrays[name] = new Rows(this.numbers, ref);
    }
    this.sensors = own.sensors.map((sensor) => ({
      ...sensor,
      step: new Rows(this.numbers, sensor.step).column(0),
      values: new Rows(this.numbers, sensor.values),
      given: sensor.given.map((parent) => ({ ...parent, rows: new Rows(this.numbers, parent.values) })),
    }));
    this.changes = new Map(Object.entries(own.moved).map(([name, ref]) => [name, new Rows(this.numbers, ref)]));
    this.true = new Map(Object.entries(own.truth).map(([name, ref]) => [name, new Rows(this.numbers, ref)]));
  }

  get run() {
    return this.place;
  }

  // Variables of a slice at a step.
  at(variables, step) {
    return variables.map((v) => ({ ...v, name: `${v.name}[${step}]` }));
  }

  // The hidden variables of a cluster: the states before, and the slice.
  scope(step) {
    if (step === 0) return this.at(this.states, 0);
    return [...this.at(this.states, step - 1), ...this.at(this.hidden, step)];
  }

  names(step) {
    return this.scope(step).map((variable) => variable.name);
  }

  // The true value of a variable at a step, as x[3]; null of one not given.
  truth(name) {
    const [, template, step] = name.match(/^(.*)\[(\d+)\]$/s) ?? [];
    const row = Number(step) - this.base;
    return row >= 0 ? this.true.get(template)?.row(row) ?? null : null;
  }

  node(id) {
    if (!(id >= this.first && id <= this.last)) return null;
    const x = (id - this.first) * this.across;
    const note = this.seen(id);
    return { id, x, y: 0, width: this.width, names: this.names(id), note, evidence: Boolean(note) };
  }

  // The sensors read at a step, and how often.
  seen(id) {
    const found = [];
    for (const { child, step } of this.sensors) {
      const count = below(step, id + 1) - below(step, id);
      if (count) found.push(child.name + (count > 1 ? ` ×${count}` : ""));
    }
    return clipped(found.join("  "), 22);
  }

  // What the colours of clusters tell.
  get changed() {
    return "moved by the readings of the step";
  }

  // How far the readings of a step moved each variable of its slice from what earlier steps
  // predict, in nats, the furthest first.
  moved(id) {
    const found = this.at(this.hidden, id).map(({ name }, k) => [
      name, this.changes.get(this.hidden[k].name)?.at(id - this.base, 0) ?? NaN,
    ]);
    return found.filter(([, nats]) => !Number.isNaN(nats)).sort(([, a], [, b]) => b - a);
  }

  neighbours(id) {
    return [id - 1, id + 1].filter((k) => k >= this.first && k <= this.last);
  }

  // The neighbours whose messages to a cluster are in this page.
  senders(id) {
    return [id - 1, id + 1].filter((k) => k >= this.base && k <= this.data.steps.end);
  }

  bounds() {
    const half = 0.5 * this.width;
    const right = (this.last - this.first) * this.across + half;
    return { left: -half, right, top: -0.5 * this.height, bottom: 0.5 * this.height };
  }

  within(box) {
    const clip = (x) => Math.min(Math.max(x, this.first), this.last);
    const low = clip(this.first + Math.floor(box.left / this.across));
    return [low, clip(this.first + Math.ceil(box.right / this.across))];
  }

  nodesIn(box) {
    const [low, high] = this.within(box);
    return Array.from({ length: high - low + 1 }, (_, k) => low + k);
  }

  edgesIn(box) {
    return this.nodesIn(box).filter((id) => id < this.last).map((id) => this.edge(id, id + 1));
  }

  edge(i, j) {
    const low = Math.min(i, j);
    const names = this.at(this.states, low).map((variable) => variable.name);
    return { id: `${low}-${low + 1}`, ends: [low, low + 1], names, label: listedNames(names, 18) };
  }

  about(id) {
    const own = id === 0 ? this.data.prior : this.data.transition;
    const cpds = own.map((given) => cpdText(given, id));
    const observed = id === 0 ? [] : this.data.inputs
      .filter((name) => own.some((given) => given.given.some(([parent]) => parent === name)))
      .map((name) => `${name}[${id}]`);
    let count = 0;
    for (const { cpd, child, step, values } of this.sensors) {
      const rows = [];
      for (let k = below(step, id); k < step.length && step[k] === id; k++) rows.push(k);
      if (rows.length) cpds.push(cpdText(cpd, id) + (rows.length > 1 ? `  ×${rows.length}` : ""));
      for (const row of rows) observed.push(`${child.name}[${id}] = ${read(child, values.row(row))}`);
      count += rows.length;
    }
    return { variables: this.names(id), observed, cpds, cut: [], count, moved: new Map(this.moved(id)), changed: this.changed };
  }

  // The places of the states among the components of the slice.
  get stateColumns() {
    const found = [];
    let at = 0;
    for (const variable of this.hidden) {
      for (let k = 0; k < variable.components.length; k++, at++) if (variable.state) found.push(at);
    }
    return found;
  }

  // Moments of the slice at a step: means, and the full covariance.
  slice(step) {
    const mean = this.arrays.mean.row(step - this.base);
    return { mean, cov: fromLower(this.arrays.cov.row(step - this.base), mean.length) };
  }

  belief(step) {
    if (this.family === "table") return this.tableBelief(step);
    const own = this.slice(step);
    const columns = this.stateColumns;
    const n = own.mean.length;
    if (this.family === "moments") {
      const moments = { mean: own.mean, cov: own.cov };
      const here = this.at(this.hidden, step);
      const kept = here.filter((variable) => variable.components);
      return gaussian(kept, { moments, why: "moments alone: this belief is no Gaussian in canonical form" });
    }
    let moments;
    if (step > 0 && !this.arrays.cross) {
      return gaussian(this.at(this.hidden, step), { moments: own, why: this.data.words.large });
    }
    if (step === 0) {
      moments = { mean: pick(own.mean, columns), cov: submatrix(own.cov, n, columns) };
    } else {
      const before = this.before(step, columns);
      const cross = this.arrays.cross.row(step - this.base);
      const front = columns.length;
      const size = front + n;
      const mean = new Float64Array(size);
      const cov = new Float64Array(size * size);
      for (let i = 0; i < front; i++) {
        mean[i] = before.mean[i];
        for (let j = 0; j < front; j++) cov[i * size + j] = before.cov[i * front + j];
        for (let j = 0; j < n; j++) {
          cov[i * size + front + j] = cov[(front + j) * size + i] = cross[i * n + j];
        }
      }
      for (let i = 0; i < n; i++) {
        mean[front + i] = own.mean[i];
        for (let j = 0; j < n; j++) cov[(front + i) * size + front + j] = own.cov[i * n + j];
      }
      moments = { mean, cov };
    }
    const canonical = canonicalOf(moments.mean, moments.cov, this.arrays.weight.at(step - this.base, 0));
    return gaussian(this.scope(step), { moments, canonical, why: canonical ? null : this.data.words.singular });
  }

  // The Gaussians of a mixture at a step, by weight.
  gaussians(step) {
    const row = step - this.base;
    const found = [];
    const kept = this.at(this.hidden, step).filter((variable) => variable.components);
    for (let k = 0; this.arrays[`gaussian.${k}.mean`]; k++) {
      const weight = this.arrays.weights.at(row, k);
      if (!(weight > 1e-6)) continue;
      const mean = this.arrays[`gaussian.${k}.mean`].row(row);
      const cov = fromLower(this.arrays[`gaussian.${k}.cov`].row(row), mean.length);
      const why = "moments alone: it is one of a mixture's Gaussians";
      found.push({ weight, factor: gaussian(kept, { moments: { mean, cov }, why }) });
    }
    return found.sort((a, b) => b.weight - a.weight);
  }

  // The tables of discrete variables that stand beside moments, at a step.
  tables(step) {
    const found = [];
    for (const [k, variable] of (this.data.discrete ?? []).entries()) {
      const values = this.arrays[`states.${k}`].row(step - this.base);
      if (Number.isNaN(values[0])) continue;
      found.push(table(this.at([variable], step), values, 0));
    }
    return found;
  }

  // The states before a step as its cluster's belief knows them: after smoothing as the one before.
  before(step, columns) {
    if (this.arrays["before.mean"]) {
      const mean = this.arrays["before.mean"].row(step - this.base);
      return { mean, cov: fromLower(this.arrays["before.cov"].row(step - this.base), mean.length) };
    }
    const own = this.slice(step - 1);
    return { mean: pick(own.mean, columns), cov: submatrix(own.cov, own.mean.length, columns) };
  }

  potential(step) {
    const { words } = this.data;
    if (this.family === "moments") return none(words.messages);
    if (this.family === "table") return this.tablePotential(step);
    const prefix = step === 0 ? "first" : "own";
    if (!this.arrays[`${prefix}.K`]) return none(words.large ?? "not in this page");
    return this.canonical(this.scope(step), prefix, step === 0 ? 0 : step - Math.max(this.base, 1));
  }

  canonical(variables, prefix, row) {
    const h = this.arrays[`${prefix}.h`].row(row);
    const g = this.arrays[`${prefix}.g`].at(row, 0);
    if (Number.isNaN(g)) return none(this.data.words.singular);
    const K = fromLower(this.arrays[`${prefix}.K`].row(row), h.length);
    return gaussian(variables, { canonical: { K, h, g } });
  }

  message(i, j) {
    const { words } = this.data;
    const step = Math.min(i, j);
    const row = step - this.base;
    const variables = this.at(this.states, step);
    if (words.messages) return none(words.messages);
    const back = i > j;
    if (back && words.back) return none(words.back);
    if (this.family === "table") {
      const name = back ? "back" : "there";
      const scale = this.arrays[back ? "back.scale" : "there.weight"].at(row, 0);
      return table(variables, this.arrays[name].row(row), scale);
    }
    if (back) return this.arrays["back.K"] ? this.canonical(variables, "back", row) : none(words.large);
    const weight = this.arrays["there.weight"].at(row, 0);
    const moments = this.past(step);
    const canonical = canonicalOf(moments.mean, moments.cov, weight);
    return gaussian(variables, { moments, canonical, why: canonical ? null : words.singular });
  }

  // The states at a step given the measurements up to it.
  past(step) {
    const row = step - this.base;
    if (this.arrays["there.mean"]) {
      const mean = this.arrays["there.mean"].row(row);
      return { mean, cov: fromLower(this.arrays["there.cov"].row(row), mean.length) };
    }
    const own = this.slice(step);
    const columns = this.stateColumns;
    return { mean: pick(own.mean, columns), cov: submatrix(own.cov, own.mean.length, columns) };
  }

  tablePotential(step) {
    if (!this.arrays["own.weights"]) return none(this.data.words.large);
    const row = step - this.base;
    const scale = this.arrays["own.scale"].at(row, 0);
    const here = this.at(this.hidden, step);
    let found;
    if (step === 0) {
      const own = this.at(this.states, 0);
      const count = sizesOf(own).reduce((a, b) => a * b, 1);
      const taken = (name, r) => this.arrays[name].row(r).slice(0, count);
      found = tableProduct(own, [
        table(own, taken("first", 0), 0), table(own, taken("own.weights", row), scale),
      ]);
    } else {
      found = tableProduct(this.scope(step), [
        table(this.scope(step), this.arrays.own.row(step - Math.max(this.base, 1)), 0),
        table(here, this.arrays["own.weights"].row(row), scale),
      ]);
    }
    const top = Math.max(...found.values);
    if (!(top > 0)) return found;
    return table(found.variables, found.values.map((v) => v / top), found.scale + Math.log(top));
  }

  tableBelief(step) {
    const row = step - this.base;
    const weight = this.arrays.weight.at(row, 0);
    const own = this.scope(step);
    if (step === 0) {
      const count = sizesOf(own).reduce((a, b) => a * b, 1);
      return table(own, this.arrays.belief.row(row).slice(0, count), weight);
    }
    if (this.arrays.pairs) {
      return table(own, this.arrays.pairs.row(step - Math.max(this.base, 1)), weight);
    }
    if (!this.arrays["own.weights"]) {
      return table(this.at(this.hidden, step), this.arrays.belief.row(row), weight,
        "over the slice alone: that over two steps is too large for this page");
    }
    const parts = [this.tablePotential(step), this.message(step - 1, step)];
    if (this.arrays.back) parts.push(this.message(step + 1, step));
    const found = normalised(tableProduct(own, parts));
    return table(own, found.values, weight);
  }

  // The probabilities of the states of one variable at a step; null where it has none.
  stateProbabilities(step, name) {
    const own = step === 0 ? this.states : this.hidden;
    const axis = own.findIndex((variable) => variable.name === name);
    if (axis < 0) return null;
    const count = sizesOf(own).reduce((a, b) => a * b, 1);
    return marginalOf(table(own, this.arrays.belief.row(step - this.base).slice(0, count), 0), axis);
  }

  residuals() {
    return null;
  }

  find(text) {
    const digits = text.match(/\d+/);
    const found = [];
    const name = text.replace(/\[?\d+\]?$/, "").trim().toLowerCase();
    const sensors = this.sensors.map((sensor) => sensor.child.name);
    const names = [...this.hidden.map((v) => v.name), ...sensors, ...this.data.inputs];
    if (digits) {
      const step = Number(digits[0]);
      if (step < this.first || step > this.last) return [];
      if (!name) found.push({ text: `cluster ${step}`, id: step });
      for (const each of names) {
        if (each.toLowerCase().startsWith(name)) {
          found.push({ text: `${each}[${step}]  in cluster ${step}`, id: step });
        }
      }
      return found;
    }
    for (const each of names) {
      if (each.toLowerCase().includes(name)) {
        found.push({ text: `${each}[${this.first}] … ${each}[${this.last}]  type a step, as ${each}[3]`, id: this.first });
      }
    }
    return found;
  }
}

function pick(values, places) {
  return Float64Array.from(places, (k) => values[k]);
}

// How many of some ascending numbers are below one.
function below(values, bound) {
  let low = 0;
  let high = values.length;
  while (low < high) {
    const middle = (low + high) >> 1;
    if (values[middle] < bound) low = middle + 1;
    else high = middle;
  }
  return low;
}

// A measurement in words.
function read(variable, values) {
  if (variable.states) {
    if (values.length === 1) return Number.isNaN(values[0]) ? "not taken" : variable.states[values[0]];
    return `(${[...values].map(short).join(", ")})`;
  }
  if ([...values].every(Number.isNaN)) return "not taken";
  const each = [...values].map((value) => (Number.isNaN(value) ? "not taken" : shown(value)));
  return each.length === 1 ? each[0] : `(${each.join(", ")})`;
}
