"""A robot and networks that are made wrong in one place each, and rows of how they are refused."""

import numpy as np
from robots import DRIVE, LANDMARKS, P0, SENSORS, Q, m, u, x
from textbooks import refusal

import pgm
from pgm import ModelError

z, SIGHT = SENSORS["range_bearing"].z, SENSORS["range_bearing"]
a, b, c, w = pgm.variables("a b c w")
pair = pgm.Variable("pair", components=("p", "q"))
I2, I3 = np.eye(2), np.eye(3)
T = 4
CALLS = []


def counting(function):
    def counted(*arguments):
        CALLS.append(arguments)
        return function(*arguments)

    return counted


def prior(variable, cov=1.0):
    size = variable.dimension
    return pgm.GaussianCPD(variable, np.zeros(size), cov * np.eye(size))


def walk(variable, cov=1.0):
    size = variable.dimension
    return pgm.LinearGaussianCPD(variable, {variable.previous: 1.0}, cov=cov * np.eye(size))


def network(prior, transition, observation=()):
    return lambda: pgm.DynamicBayesianNetwork(prior, transition, observation)


def linear(child, *given, cov=1.0):
    def matrix(parent):
        return np.zeros((child.dimension, parent.dimension))

    return pgm.LinearGaussianCPD(
        child, {p: matrix(p) for p in given}, cov=cov * np.eye(child.dimension)
    )


def model_row(name, call, *words, **attributes):
    return refusal(name, call, ModelError, *words, **attributes)


U, VALUES = np.tile([1.0, 0.1], (T, 1)), np.tile([8.0, 1.0], (T, 1))
EVIDENCE = {u: U, z: VALUES, m: pgm.constant(LANDMARKS[0])}


def robot(drive=DRIVE, sight=SIGHT.function, cov=Q, by=None, by_sight=None, **options):
    """A robot with other functions, and its CPDs."""
    move = pgm.NonlinearGaussianCPD(
        x, (x.previous, u), counting(drive), cov, jacobian=by, **options
    )
    look = pgm.NonlinearGaussianCPD(
        z, (x, m), counting(sight), SIGHT.cov, jacobian=by_sight, **options
    )
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(x, [0, 0, 0], P0)], [move], [look])
    return model, move, look


def function_row(name, error, words, made, about=1, infer=pgm.smooth, step=None, options=None):
    """A row about the motion (about=1) or the sensor (about=2) of a robot."""
    model, cpd = made[0], made[about]
    attributes = {"cpd": cpd, "variable": cpd.child, "step": step}

    def call():
        infer(model, EVIDENCE, **(options or {}))

    return refusal(name, call, error, *words, **attributes)
