"""Dynamic networks of many shapes for tests of structure: their functions are never called."""

import numpy as np

import pgm
from pgm import DynamicBayesianNetwork, GaussianCPD, LinearGaussianCPD, NonlinearGaussianCPD

X = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
U = pgm.Variable("u", components=("v", "omega"))
M = pgm.Variable("m", components=("east", "north"))
Z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
A, B, COMMAND, W, TIRES = pgm.variables("a b command w tires")


def never(*arguments):
    raise AssertionError("a user's function was called while the model was compiled")


def start(variable):
    return GaussianCPD(variable, np.zeros(variable.dimension), np.eye(variable.dimension))


def nonlinear(child, *given, cov=None):
    cov = np.eye(child.dimension) if cov is None else cov
    return NonlinearGaussianCPD(child, given, never, cov)


def static(variable):
    return LinearGaussianCPD(variable, {variable.previous: 1.0}, cov=np.zeros((2, 2)))


MODELS = {
    "localisation": DynamicBayesianNetwork(
        [start(X)], [nonlinear(X, X.previous, U)], [nonlinear(Z, X, M)]
    ),
    "no sensor": DynamicBayesianNetwork([start(A)], [nonlinear(A, A.previous)]),
    "several states": DynamicBayesianNetwork(
        [start(A), nonlinear(B, A), start(X)],
        [
            nonlinear(A, A.previous, B.previous),
            nonlinear(B, B.previous, A),
            nonlinear(X, X.previous),
        ],
        [nonlinear(W, A, X), nonlinear(Z, X, M)],
    ),
    "hidden control": DynamicBayesianNetwork(
        [start(X)],
        [nonlinear(U, COMMAND), nonlinear(X, X.previous, U)],
        [nonlinear(W, U), nonlinear(Z, X, M)],
    ),
    "static unknown": DynamicBayesianNetwork(
        [start(X), start(M)], [nonlinear(X, X.previous, U), static(M)], [nonlinear(Z, X, M)]
    ),
    "noise of an input": DynamicBayesianNetwork(
        [start(A)], [nonlinear(A, A.previous, cov=pgm.noise(never, given=TIRES))]
    ),
}
