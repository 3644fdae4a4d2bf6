"""Textbook twins for the tests: dense joint Gaussians, written without pgm's kernels."""

from dataclasses import dataclass

import numpy as np
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import multivariate_normal

from pgm.linearisers import BoundFunction

algebra = settings(max_examples=40, deadline=None)
entries = st.floats(-3.0, 3.0, allow_subnormal=False).map(lambda value: round(value, 3))


def vectors(size):
    """Draw small vectors whose digits stay readable when hypothesis shrinks them."""
    return arrays(float, size, elements=entries)


def matrices(rows, columns):
    """Draw small matrices."""
    return arrays(float, (rows, columns), elements=entries)


def definite(size):
    """Draw well-conditioned symmetric positive definite matrices."""
    return matrices(size, size).map(lambda a: a @ a.T + np.eye(size))


def random_covariance(rng, size, rank=None, lead=()):
    """Draw covariances, of full rank or less."""
    root = rng.normal(size=(*lead, size, size if rank is None else rank))
    return root @ root.swapaxes(-1, -2)


@dataclass(frozen=True)
class Joint:
    """A dense Gaussian over labelled blocks."""

    places: dict
    mean: np.ndarray
    cov: np.ndarray

    def index(self, *labels):
        """Where some blocks stand."""
        everywhere = np.arange(self.mean.size)
        return np.concatenate([everywhere[self.places[label]] for label in labels])

    def marginal(self, *labels):
        """Mean and covariance of some blocks, in the order asked for."""
        index = self.index(*labels)
        return self.mean[index], self.cov[np.ix_(index, index)]

    def cross(self, a, b):
        """The covariance of one block with another."""
        return self.cov[np.ix_(self.index(a), self.index(b))]

    def given(self, evidence):
        """Condition on values by label, NaN not known; also return the values' log-density."""
        value = np.concatenate([np.zeros(0), *(np.ravel(each) for each in evidence.values())])
        known = ~np.isnan(value)
        if not known.any():
            return self, 0.0
        value, seen = value[known], self.index(*evidence)[known]
        mean, cov = self.mean[seen], self.cov[np.ix_(seen, seen)]
        gain = self.cov[:, seen] @ np.linalg.pinv(cov, hermitian=True, rcond=1e-11)
        posterior = self.cov - gain @ self.cov[seen]
        log_density = multivariate_normal(mean, cov, allow_singular=True).logpdf(value)
        return Joint(self.places, self.mean + gain @ (value - mean), posterior), log_density


def linear_joint(nodes):
    """Solve v = A v + c + n for the joint of all v.

    Nodes are (label, {parent: matrix}, offset, noise covariance), in any order.
    """
    places, start = {}, 0
    for label, _, offset, _ in nodes:
        places[label] = slice(start, start + len(offset))
        start += len(offset)
    matrix, shift, noise = np.zeros((start, start)), np.zeros(start), np.zeros((start, start))
    for label, parents, offset, cov in nodes:
        rows = places[label]
        shift[rows], noise[rows, rows] = offset, cov
        for parent, factor in parents.items():
            matrix[rows, places[parent]] = factor
    total = np.linalg.inv(np.eye(start) - matrix)
    return Joint(places, total @ shift, total @ noise @ total.T)


def unrolled(model, steps, inputs=None, sightings=()):
    """Lay out the joint of a linear dynamic network.

    Labels are variables at steps, and (sensor, k) for the k-th sighting; `inputs` are arrays
    (T, d) of steps 1..T, `sightings` are (sensor, step, {input: value}).
    """
    inputs = inputs or {}
    cpds = {cpd.child: cpd for cpd in model.observation}

    def node(label, cpd, step, known):
        offset, parents = np.array(cpd.offset), {}
        for parent, matrix in cpd.matrices.items():
            if parent in known:
                offset = offset + matrix @ np.ravel(known[parent])
            elif parent in inputs:
                offset = offset + matrix @ inputs[parent][step - 1]
            else:
                parents[parent.at(step)] = matrix
        return label, parents, offset, cpd.cov

    nodes = [node(cpd.child.at(0), cpd, 0, {}) for cpd in model.prior]
    for step in range(1, steps + 1):
        nodes += [node(cpd.child.at(step), cpd, step, {}) for cpd in model.transition]
    for k, (sensor, step, known) in enumerate(sightings):
        nodes.append(node((sensor, k), cpds[sensor], step, known))
    return linear_joint(nodes)


def bound_function(cpd, inputs=None, lead=0, step=None):
    """Bind a nonlinear CPD's function as the engine does, evidence (*lead, d) by variable."""
    inputs = inputs or {}
    hidden = tuple(parent for parent in cpd.given if parent not in inputs)
    known = tuple(
        None if parent in hidden else np.asarray(inputs[parent], float) for parent in cpd.given
    )
    return BoundFunction(cpd._template(hidden), known, lead, step)
