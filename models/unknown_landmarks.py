"""A robot that drives among landmarks whose places it hardly knows.

Poses are x[0], x[1], …; landmark k is m{k}, and z{k}[t] is its sighting from x[t]. A landmark that
is seen twice ties two poses together that their motion ties too: the network has loops.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

import pgm
from models import motion, sensors
from models.networks import landmark, pose, sighting, velocity
from models.networks.covariances import diagonal

# Which landmark is seen from which pose: (step, landmark).
Seen = Iterable[tuple[int, int]]


def place(k: int) -> pgm.Variable:
    """Where landmark k is [m]."""
    return pgm.Variable(f"{landmark.name}{k}", landmark.components)


def reading(step: int, k: int) -> pgm.Variable:
    """The range [m] and bearing [rad] of landmark k from the pose at a step."""
    angles = ("bearing",)
    return pgm.Variable(f"{sighting.name}{k}", sighting.components, angles=angles).at(step)


def unknown_landmarks(
    steps: int,
    seen: Seen,
    guesses: Sequence[Sequence[float]],
    *,
    dt: float = 1.0,
    start_std: Sequence[float] = (0.1, 0.1, 0.05),
    motion_std: Sequence[float] = (0.2, 0.2, 0.1),
    guess_std: float = 1.0,
    sensor_std: Sequence[float] = (0.2, 0.05),
) -> pgm.BayesianNetwork:
    """The network: its velocities u[1], u[2], … are inputs.

        p(x[0]) Π p(x[t] | x[t−1], u[t]) Π p(m{k}) Π p(z{k}[t] | x[t], m{k})

    Parameters
    ----------
    steps : int
        T: poses are x[0] to x[T].
    seen : iterable of (int, int)
        The sightings: step and landmark.
    guesses : sequence of (float, float)
        The prior mean of each landmark [m].
    dt : float
        Seconds a step.
    start_std, motion_std, sensor_std : sequence of float
        Standard deviations of the first pose and of the motion's noise [m, m, rad], and of a
        sighting [m, rad].
    guess_std : float
        Standard deviation of the guesses [m].
    """
    drive = motion.Velocity(dt=dt)
    cpds: list[pgm.GaussianCPD | pgm.NonlinearGaussianCPD] = [
        pgm.GaussianCPD(pose.at(0), mean=np.zeros(3), cov=diagonal(start_std))
    ]
    for t in range(1, steps + 1):
        before, control = pose.at(t - 1), velocity.at(t)
        cpds.append(
            pgm.NonlinearGaussianCPD(
                pose.at(t),
                given=(before, control),
                function=drive,
                cov=diagonal(motion_std),
                jacobian={before: drive.by_state, control: drive.by_control},
            )
        )
    cpds += [
        pgm.GaussianCPD(place(k), mean=guess, cov=guess_std**2 * np.eye(2))
        for k, guess in enumerate(guesses)
    ]
    for t, k in seen:
        cpds.append(
            pgm.NonlinearGaussianCPD(
                reading(t, k),
                given=(pose.at(t), place(k)),
                function=sensors.range_bearing,
                cov=diagonal(sensor_std),
                jacobian={
                    pose.at(t): sensors.range_bearing_by_state,
                    place(k): sensors.range_bearing_by_landmark,
                },
            )
        )
    return pgm.BayesianNetwork(cpds)


def landmark_clusters(
    network: pgm.BayesianNetwork, carried: Sequence[int] = ()
) -> pgm.ClusterGraph:
    """A cluster graph by hand: the chain of poses carries some landmarks along.

    Clusters {x[t−1], x[t], carried landmarks} form a chain, in which those landmarks are treated as
    in a junction tree. Every sighting of another landmark has a cluster {x[t], m{k}} of its own,
    joined to the chain by x[t], and to the next sighting of that landmark by m{k}: there are the
    loops. With no landmark carried it does what a Bethe graph does; with all it is a tree.

    Parameters
    ----------
    network : BayesianNetwork
        From `unknown_landmarks`.
    carried : sequence of int
        Numbers of landmarks.
    """
    along = {place(k) for k in carried}
    families = [cpd.scope for cpd in network.cpds if len(cpd.parents) == 2]
    chain = [{*family, *along} for family in families if family[2].template == velocity]
    sepsets = {(t - 1, t): {pose.at(t), *along} for t in range(1, len(chain))}
    sighted: list[set[pgm.Variable]] = []
    last: dict[pgm.Variable, int] = {}
    for z, x, m in (family for family in families if family[2].template != velocity):
        assert x.step is not None
        home = max(x.step - 1, 0)
        if m in along:
            chain[home].add(z)
            continue
        new = len(chain) + len(sighted)
        sighted.append({z, x, m})
        sepsets[home, new] = {x}
        if m in last:
            sepsets[last[m], new] = {m}
        last[m] = new
    return pgm.ClusterGraph(network, [*chain, *sighted], sepsets)
