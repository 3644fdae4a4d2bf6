// Factors: Gaussians in canonical form, in moments or both, tables, and the words for none.

const none = (why) => ({ type: "none", why });

function gaussian(variables, { canonical = null, moments = null, why = null }) {
  const labels = [];
  for (const variable of variables) {
    for (const component of variable.components) {
      labels.push(variable.components.length === 1 ? variable.name : `${variable.name} ${component}`);
    }
  }
  const found = { type: "gaussian", variables, labels, canonical, moments, why };
  if (!moments && canonical) found.moments = momentsOf(canonical);
  return found;
}

function table(variables, values, scale, why = null) {
  return { type: "table", variables, values, scale, why };
}

const sizesOf = (variables) => variables.map((variable) => variable.states.length);

// The product of Gaussians in canonical form, over the variables of the first; null where one has
// no such form.
function gaussianProduct(first, others) {
  if (first.type !== "gaussian" || !first.canonical) return null;
  const n = first.labels.length;
  const K = first.canonical.K.slice();
  const h = first.canonical.h.slice();
  let g = first.canonical.g;
  const place = new Map(first.labels.map((label, k) => [label, k]));
  for (const other of others) {
    if (other.type !== "gaussian" || !other.canonical) return null;
    const at = other.labels.map((label) => place.get(label));
    const m = at.length;
    for (let i = 0; i < m; i++) {
      h[at[i]] += other.canonical.h[i];
      for (let j = 0; j < m; j++) K[at[i] * n + at[j]] += other.canonical.K[i * m + j];
    }
    g += other.canonical.g;
  }
  return { K, h, g };
}

// The product of tables over some variables, which hold those of all.
function tableProduct(variables, parts) {
  const sizes = sizesOf(variables);
  const values = new Float64Array(sizes.reduce((a, b) => a * b, 1)).fill(1);
  let scale = 0;
  for (const part of parts) {
    const steps = stepsWithin(variables, part.variables);
    const index = new Array(sizes.length).fill(0);
    let at = 0;
    for (let k = 0; k < values.length; k++) {
      values[k] *= part.values[at];
      for (let axis = sizes.length - 1; axis >= 0; axis--) {
        index[axis] += 1;
        at += steps[axis];
        if (index[axis] < sizes[axis]) break;
        at -= steps[axis] * sizes[axis];
        index[axis] = 0;
      }
    }
    scale += part.scale;
  }
  return table(variables, values, scale);
}

// How many entries of a table the next state of each of some variables is further on.
function stepsWithin(variables, own) {
  const steps = new Map();
  let step = 1;
  for (let k = own.length - 1; k >= 0; k--) {
    steps.set(own[k].name, step);
    step *= own[k].states.length;
  }
  return variables.map((variable) => steps.get(variable.name) ?? 0);
}

function sum(values) {
  let total = 0;
  for (const value of values) total += value;
  return total;
}

// Values divided by their sum, which goes into the scale.
function normalised(given) {
  const total = sum(given.values);
  if (!(total > 0)) return given;
  return table(given.variables, given.values.map((v) => v / total), given.scale + Math.log(total));
}

// The probabilities of the states of one variable.
function marginalOf(factor, axis) {
  if (factor.type === "largest") return factor.marginals[axis];
  const sizes = sizesOf(factor.variables);
  const after = sizes.slice(axis + 1).reduce((a, b) => a * b, 1);
  const found = new Float64Array(sizes[axis]);
  factor.values.forEach((value, k) => {
    found[Math.floor(k / after) % sizes[axis]] += value;
  });
  const total = sum(found);
  return total > 0 ? found.map((value) => value / total) : found;
}

// The states of an entry of a table.
function statesAt(variables, entry) {
  const found = [];
  let rest = entry;
  for (let k = variables.length - 1; k >= 0; k--) {
    const size = variables[k].states.length;
    found.unshift(variables[k].states[rest % size]);
    rest = Math.floor(rest / size);
  }
  return found;
}
