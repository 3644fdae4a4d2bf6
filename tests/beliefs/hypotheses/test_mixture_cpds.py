"""Mixtures of CPDs in chains of Gaussian beliefs: a component is a hypothesis."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

import pgm

X, Z, U = pgm.variables("x z u")
C = pgm.Discrete("c", states=("0", "1"))


def line(child, given, cov, offset=0.0):
    return pgm.LinearGaussianCPD(child, given, cov=cov, offset=offset)


def mixed(first, second, weights=(0.7, 0.3)):
    return pgm.MixtureCPD([first, second], weights)


PRIOR = pgm.GaussianCPD(X, -2.0, 0.5), pgm.GaussianCPD(X, 2.0, 1.0)
MOTION = line(X, {X.previous: 0.9, U: 1.0}, 0.1), line(X, {X.previous: 0.5}, 3.0, 1.0)
SENSOR = line(Z, {X: 1.0}, 0.2), pgm.GaussianCPD(Z, 0.0, 20.0)
VALUES = np.array([[1.0], [np.nan], [3.0]])
ALL = pgm.Gaussians(200)


def model(prior, motion, sensor):
    return pgm.DynamicBayesianNetwork([prior], [motion], [sensor])


@pytest.mark.parametrize("place", ["prior", "motion", "sensor"])
def test_beliefs_are_weighted_filters_of_each_component_in_turn(place):
    """All sequences of components, each by an ordinary smoother on a network of its own."""
    given = {U: [[0.5], [-0.3], [0.1]], Z: VALUES}
    parts = {"prior": PRIOR[0], "motion": MOTION[0], "sensor": SENSOR[0]}
    whole = {"prior": PRIOR, "motion": MOTION, "sensor": SENSOR}[place]
    weights = np.array([0.7, 0.3])
    found = pgm.smooth(model(**{**parts, place: mixed(*whole)}), given, belief=ALL)
    cases = dict(enumerate(whole))
    table = pgm.TableCPD(C, table=weights)
    chosen = pgm.SwitchingCPD(whole[0].child, C, cases)
    prior, motion, sensor = ({**parts, place: chosen}[name] for name in parts)
    same = pgm.DynamicBayesianNetwork([table, prior], [table, motion], [sensor])
    due = pgm.smooth(same, given, belief=ALL)
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)
    assert_allclose(found[X].mean, due[X].mean, atol=1e-12)
    assert_allclose(found[X].cov, due[X].cov, atol=1e-12)


def test_all_three_against_a_grid():
    """Of a fine grid, as filter and smoother."""
    network = model(mixed(*PRIOR), mixed(*MOTION), mixed(*SENSOR))
    given = {U: [[0.5], [-0.3], [0.1]], Z: VALUES}
    grid = pgm.Grid({"x": (-14.0, 14.0, 1600)})
    for run in (pgm.filter, pgm.smooth):
        due, found = run(network, given, belief=grid), run(network, given, belief=ALL)
        assert_allclose(found.log_evidence, due.log_evidence, atol=2e-3)
        assert_allclose(found[X].mean, due[X].mean, atol=5e-3)
        assert_allclose(found[X].cov, due[X].cov, rtol=2e-2)


def test_sightings_of_a_step_have_components_of_their_own():
    """Enumerated: each of five sightings is of one component or the other."""
    network = model(PRIOR[0], line(X, {X.previous: 1.0}, 0.1), mixed(*SENSOR))
    values, steps = np.array([[-1.0], [-2.0], [9.0], [0.5], [-1.5]]), [0, 1, 1, 1, 2]
    found = pgm.filter(network, {Z: pgm.sightings(values, step=steps)}, steps=2, belief=ALL)
    logs, means, seconds = [], [], []
    for which in np.ndindex(*[2] * 5):
        mean, var, log = -2.0, 0.5, 0.0
        for t in range(3):
            var += 0.1 * (t > 0)
            for k, value, step in zip(which, values[:, 0], steps, strict=True):
                if step != t:
                    continue
                at, spread = (mean, var + 0.2) if k == 0 else (0.0, 20.0)
                log += np.log([0.7, 0.3][k])
                log -= 0.5 * ((value - at) ** 2 / spread + np.log(2 * np.pi * spread))
                if k == 0:
                    mean, var = mean + var / spread * (value - mean), var * 0.2 / spread
        logs.append(log)
        means.append(mean)
        seconds.append(var + mean**2)
    total = np.logaddexp.reduce(logs)
    share = np.exp(logs - total)
    assert_allclose(found.log_evidence, total, rtol=1e-12)
    assert_allclose(found[X.at(2)].mean, [share @ means], rtol=1e-12)
    second = share @ seconds
    assert_allclose(found[X.at(2)].cov, [[second - (share @ means) ** 2]], rtol=1e-10)


def test_one_gaussian_unless_more_are_asked_for_and_mixtures_of_mixtures():
    sensor = mixed(mixed(*SENSOR), line(Z, {X: 1.0}, 5.0), (0.8, 0.2))
    network = model(PRIOR[0], line(X, {X.previous: 1.0}, 0.1), sensor)
    found = pgm.filter(network, {Z: [[-1.0], [4.0]]})
    assert len(found[X].weights[0]) == 1
    moving = model(mixed(*PRIOR), mixed(*MOTION), SENSOR[0])
    tables = pgm.filter(moving, {U: [[0.0]], Z: [[-1.0]]})
    for name, at in (("component of x", 0), ("component of x'", 1)):
        cause = pgm.Discrete(name, states=("0", "1"))
        assert_allclose(tables[cause.at(at)].probabilities.sum(), 1.0)
    assert not found.associations


def test_runs_and_online_motions():
    """A filter's steps; a sensor's sightings are not counted online, and are refused there."""
    network = model(PRIOR[0], mixed(*MOTION), SENSOR[0])
    controls, values = np.full((4, 1), 0.5), np.array([[1.0], [2.0], [1.0], [0.0]])
    every = {U: np.stack([controls, 2 * controls]), Z: np.stack([values, -values])}
    found = pgm.filter(network, every, belief=pgm.Gaussians(3))
    for run in range(2):
        own = {variable: each[run] for variable, each in every.items()}
        alone = pgm.filter(network, own, belief=pgm.Gaussians(3))
        assert_allclose(found[X].mean[run], alone[X].mean, atol=1e-12)
        online = pgm.OnlineFilter(network, belief=pgm.Gaussians(3))
        belief = online.initial()
        for t in range(4):
            belief = online.predict(belief, {U: own[U][t]})
            belief = online.update(belief, {Z: own[Z][t]})
        assert_allclose(belief[X].mean, alone[X.at(4)].mean, atol=1e-12)
        assert_allclose(belief.log_evidence, alone.log_evidence, rtol=1e-12)


def test_sightings_online_and_many_of_them():
    """Several in an update are those of the filter; twenty at a step are tried one by one."""
    network = model(PRIOR[0], line(X, {X.previous: 1.0}, 0.1), mixed(*SENSOR))
    rng = np.random.default_rng(0)
    values, steps = rng.standard_normal((24, 1)) - 1.0, [0, 1, 1, 1, *[2] * 20]
    found = pgm.filter(network, {Z: pgm.sightings(values, step=steps)}, steps=2)
    online = pgm.OnlineFilter(network)
    belief = online.update(online.initial(), {Z: pgm.sightings(values[:1])})
    belief = online.update(online.predict(belief), {Z: pgm.sightings(values[1:4])})
    belief = online.update(online.predict(belief), {Z: pgm.sightings(values[4:])})
    assert_allclose(belief.log_evidence, found.log_evidence, rtol=1e-9)
    assert_allclose(belief[X].mean, found[X.at(2)].mean, rtol=1e-9)


def test_components_with_inputs_of_their_own_and_missing_readings():
    """Against a switching sensor of one sighting a step, whose cause is a variable."""
    parts = line(Z, {X: 1.0, U: 0.5}, 0.2), line(Z, {U: -1.0}, 3.0)
    motion = line(X, {X.previous: 0.9}, 0.2)
    given = {U: [[0.5], [-0.3], [0.1]], Z: VALUES}
    found = pgm.smooth(model(PRIOR[0], motion, mixed(*parts)), given, belief=ALL)
    table = pgm.TableCPD(C, table=[0.7, 0.3])
    chosen = pgm.SwitchingCPD(Z, C, dict(enumerate(parts)))
    same = pgm.DynamicBayesianNetwork([PRIOR[0]], [table, motion], [chosen])
    due = pgm.smooth(same, given, belief=ALL)
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)
    assert_allclose(found[X].mean, due[X].mean, atol=1e-12)


def test_what_is_refused():
    network = model(PRIOR[0], line(X, {X.previous: 1.0}, 0.1), mixed(*SENSOR))
    given = {Z: [[0.0]]}
    with pytest.raises(pgm.ModelError, match="mixtures of CPDs and open sightings have hypotheses"):
        pgm.smooth(network, given, belief=pgm.Gaussians(2, starts=4))
    with pytest.raises(pgm.ModelError, match="sensor of several components, which no audit"):
        pgm.audit(pgm.smooth(network, given), rng=0)
    with pytest.raises(pgm.GraphError, match="mixtures have posterior"):
        pgm.most_probable(pgm.compile(network, 1), given)
    still = pgm.BayesianNetwork([PRIOR[0], mixed(*SENSOR)])
    with pytest.raises(pgm.ModelError, match="leave belief= out"):
        pgm.infer(pgm.compile(still), {Z: [0.0]}, belief=pgm.Gaussians(2, starts=4))
    mark = pgm.Variable("mark")
    seen = mixed(line(Z, {X: 1.0, mark: 1.0}, 0.2), SENSOR[1])
    both = pgm.sightings([[0.0]], step=[1], given={mark: pgm.unknown([[0.0], [1.0]])})
    with pytest.raises(pgm.EvidenceError, match="is a mixture, and its sightings leave"):
        pgm.filter(model(PRIOR[0], line(X, {X.previous: 1.0}, 0.1), seen), {Z: both}, steps=1)
    exact = mixed(line(Z, {X: 1.0}, 0.0), pgm.GaussianCPD(Z, 5.0, 0.0))
    certain = model(pgm.GaussianCPD(X, 0.0, 0.0), line(X, {X.previous: 1.0}, 0.0), exact)
    with pytest.raises(pgm.NumericalError, match="have probability zero"):
        pgm.filter(certain, {Z: [[1.0]]})


def test_components_that_are_not_gaussian_are_refused():
    drawn = pgm.SampledCPD(Z, given=X, sample=lambda x, rng: x + rng.standard_normal(x.shape))
    network = model(PRIOR[0], line(X, {X.previous: 1.0}, 0.1), mixed(SENSOR[0], drawn))
    with pytest.raises(pgm.ModelError, match=r"SampledCPD\(z \| x\).*belief=pgm.Particles"):
        pgm.filter(network, {Z: [[0.0]]})
