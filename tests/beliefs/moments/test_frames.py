"""How many calls lie between `pgm.filter` and the functions of a user, at any step of its sweep.

A traceback of theirs shows these frames, and who follows a value goes through them.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

import pgm
from pgm.schedules import sweep

PACKAGE, T = Path(pgm.__file__).parent, 5
# One of these is `filter` itself, below the one that tells of arguments that do not fit.
MOST = 9
RULES = [pgm.Taylor(), pgm.Unscented()]
LEADS = [(), (3,), (40,)]

x = pgm.Variable("x", components=("east", "heading"), angles=("heading",))
place, speed = pgm.variables("place speed")
u = pgm.Variable("u")
z = pgm.Variable("z", components=("bearing",), angles=("bearing",))


def between():
    """The package's frames from the public `filter`, not counted, to the caller's caller."""
    found, frame = [], sys._getframe(2)
    while frame is not None:
        if PACKAGE in Path(frame.f_code.co_filename).parents:
            found.append(frame.f_code)
        frame = frame.f_back
    return found[:-1]


class Recorder:
    """A function that keeps the frames above each of its calls in a sweep."""

    def __init__(self, function):
        self.function, self.above = function, []

    def __call__(self, *arguments):
        above = between()
        if sweep.forward.__code__ in above:  # not in a trial, nor to judge a trace
            self.above.append([code.co_qualname for code in above])
        return self.function(*arguments)


def moved(x, u):
    return x + np.stack([np.cos(x[..., 1]), u[..., 0]], axis=-1)


def moved_by_x(x, u):
    slope = np.zeros((*x.shape, 2)) + np.eye(2)
    slope[..., 0, 1] = -np.sin(x[..., 1])
    return slope


def seen(x):
    return np.arctan(x[..., :1]) - x[..., 1:]


def seen_by_x(x):
    return np.stack([1.0 / (1.0 + x[..., 0] ** 2), -np.ones(x.shape[:-1])], axis=-1)[..., None, :]


def evidence(lead):
    return {u: np.full((*lead, T, 1), 0.1), z: np.full((*lead, T, 1), 0.2)}


def undivided(drive, sight):
    """All of the state in one variable."""
    cov, by = 0.01 * np.eye(2), {x.previous: moved_by_x}
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, np.zeros(2), cov)],
        [pgm.NonlinearGaussianCPD(x, (x.previous, u), drive, cov, jacobian=by)],
        [pgm.NonlinearGaussianCPD(z, x, sight, 0.1, jacobian={x: seen_by_x})],
    )


def divided(drive, sight):
    """A state of two variables, of which the sensor sees the first."""

    def faster(v, u):
        return drive(np.concatenate([v, v], axis=-1), u)[..., 1:]

    def at(p):
        return sight(np.concatenate([p, p], axis=-1))

    def slope(p, *_):
        return np.full((*p.shape, 1), 0.5)

    before, by = (speed.previous, u), {speed.previous: slope}
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.0, 1.0), pgm.GaussianCPD(speed, 0.0, 1.0)],
        [
            pgm.NonlinearGaussianCPD(speed, before, faster, 0.01, jacobian=by),
            pgm.LinearGaussianCPD(place, {place.previous: 1.0, speed: 1.0}, cov=0.01),
        ],
        [pgm.NonlinearGaussianCPD(z, place, at, 0.1, jacobian={place: slope})],
    )


@pytest.mark.parametrize("lead", LEADS, ids=str)
@pytest.mark.parametrize("rule", RULES, ids=lambda rule: type(rule).__name__)
@pytest.mark.parametrize("network", [undivided, divided])
def test_few_frames_lie_between_a_filter_and_the_functions_of_a_user(network, rule, lead):
    drive, sight = Recorder(moved), Recorder(seen)
    pgm.filter(network(drive, sight), evidence(lead), lineariser=rule, compiled=False)
    for recorder in (drive, sight):
        assert len(recorder.above) >= T
        assert max(map(len, recorder.above)) <= MOST, recorder.above[-1]
