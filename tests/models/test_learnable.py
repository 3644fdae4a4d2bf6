"""What is off in sensors and odometry is found from a drawn drive."""

import numpy as np

import pgm
from models import sensors
from models.networks import distance, pose, travelled
from models.networks.learnable import correction, rolls_corrected, sees_each

PLACES = {"north": (0.0, 8.0), "east": (8.0, 0.0), "south": (1.0, -7.0)}


def network(each):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(pose, [0, 0, 0], 1e-4)],
        [rolls_corrected([0.01, 0.01, 0.005])],
        each.cpds,
    )


def test_biases_noises_and_odometry_are_learnt():
    rng = np.random.default_rng(1)
    each = sees_each(distance, sensors.RANGE, PLACES, 0.1)
    moves = np.column_stack([np.full(240, 0.5), 0.15 * np.sin(np.arange(240) / 7), np.ones(240)])
    names = np.array(list(PLACES))[np.arange(480) % 3].tolist()
    step = np.repeat(np.arange(1, 241), 2)
    true = {correction: [0.95, 1.1, 0.02]}
    true |= dict(zip(each.biases.values(), ([0.3], [-0.2], [0.0]), strict=True))
    given = {v: pgm.constant(np.array(value)) for v, value in true.items()}
    blank = each.evidence(np.zeros((480, 1)), step, names)
    drawn = network(each).sample({travelled: moves, **given, **blank}, rng=rng)
    start = sees_each(distance, sensors.RANGE, PLACES, 0.3)
    evidence = {travelled: moves} | {z: drawn.evidence[z] for z in each.readings.values()}
    learn = {**start.learn, correction: pgm.learning.Parameter([1.0, 1.0, 0.0])}
    found = pgm.fit(network(start), evidence, learn=learn, tolerance=1e-2)
    for variable, value in true.items():
        np.testing.assert_allclose(found.parameters[variable], value, atol=0.05)
    for cpd in found.model.observation:
        assert 0.08 < np.sqrt(cpd.cov[0, 0]) < 0.12
