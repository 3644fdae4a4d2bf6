// Small symmetric matrices, as flat arrays of n × n numbers: what the page derives from the data.

const LOG_2PI = Math.log(2 * Math.PI);
// Pivots of a matrix with unit diagonal below this are rounding: it is singular.
const NEGLIGIBLE = 1e-13;

function fromLower(packed, n) {
  const full = new Float64Array(n * n);
  let at = 0;
  for (let i = 0; i < n; i++) {
    for (let j = 0; j <= i; j++) full[i * n + j] = full[j * n + i] = packed[at++];
  }
  return full;
}

function submatrix(matrix, n, rows, columns = rows) {
  const found = new Float64Array(rows.length * columns.length);
  rows.forEach((i, a) => columns.forEach((j, b) => {
    found[a * columns.length + b] = matrix[i * n + j];
  }));
  return found;
}

// The inverse of a positive definite matrix and the logarithm of its determinant; null of others.
// Scaled to unit diagonal first, so that units do not matter.
function inverted(matrix, n) {
  const scale = new Float64Array(n);
  for (let i = 0; i < n; i++) {
    const own = matrix[i * n + i];
    if (!(own > 0) || !Number.isFinite(own)) return null;
    scale[i] = Math.sqrt(own);
  }
  const lower = new Float64Array(n * n);
  let log = 0;
  for (let i = 0; i < n; i++) {
    for (let j = 0; j <= i; j++) {
      let sum = matrix[i * n + j] / (scale[i] * scale[j]);
      for (let k = 0; k < j; k++) sum -= lower[i * n + k] * lower[j * n + k];
      if (i === j) {
        if (!(sum > NEGLIGIBLE)) return null;
        lower[i * n + i] = Math.sqrt(sum);
        log += Math.log(sum) + 2 * Math.log(scale[i]);
      } else {
        lower[i * n + j] = sum / lower[j * n + j];
      }
    }
  }
  // L⁻¹, then (L⁻¹)ᵀ L⁻¹.
  const solved = new Float64Array(n * n);
  for (let j = 0; j < n; j++) {
    for (let i = j; i < n; i++) {
      let sum = i === j ? 1 : 0;
      for (let k = j; k < i; k++) sum -= lower[i * n + k] * solved[k * n + j];
      solved[i * n + j] = sum / lower[i * n + i];
    }
  }
  const inverse = new Float64Array(n * n);
  for (let i = 0; i < n; i++) {
    for (let j = 0; j <= i; j++) {
      let sum = 0;
      for (let k = i; k < n; k++) sum += solved[k * n + i] * solved[k * n + j];
      inverse[i * n + j] = inverse[j * n + i] = sum / (scale[i] * scale[j]);
    }
  }
  return { inverse, log };
}

function times(matrix, vector) {
  const n = vector.length;
  const found = new Float64Array(matrix.length / n);
  for (let i = 0; i < found.length; i++) {
    let sum = 0;
    for (let j = 0; j < n; j++) sum += matrix[i * n + j] * vector[j];
    found[i] = sum;
  }
  return found;
}

function inner(a, b) {
  let sum = 0;
  for (let k = 0; k < a.length; k++) sum += a[k] * b[k];
  return sum;
}

// exp(weight) N(x; mean, cov) as K, h, g.
function canonicalOf(mean, cov, weight) {
  const n = mean.length;
  const done = inverted(cov, n);
  if (done === null) return null;
  const h = times(done.inverse, mean);
  return { K: done.inverse, h, g: weight - 0.5 * (inner(h, mean) + n * LOG_2PI + done.log) };
}

// The mean, covariance and log-integral of K, h, g; null where it has none.
function momentsOf({ K, h, g }) {
  const n = h.length;
  const done = inverted(K, n);
  if (done === null) return null;
  const mean = times(done.inverse, h);
  return { mean, cov: done.inverse, log: g + 0.5 * (n * LOG_2PI - done.log + inner(h, mean)) };
}

// Half axes and direction of the region of a planar Gaussian that holds a share of it.
function ellipseOf(a, b, c, share = 0.95) {
  const middle = 0.5 * (a + c);
  const apart = Math.hypot(0.5 * (a - c), b);
  const level = -2 * Math.log(1 - share);
  return {
    long: Math.sqrt(level * Math.max(middle + apart, 0)),
    short: Math.sqrt(level * Math.max(middle - apart, 0)),
    angle: 0.5 * Math.atan2(2 * b, a - c),
  };
}
