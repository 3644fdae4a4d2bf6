"""Cases that are mixtures, or of robust noise, which hidden discrete variables choose."""

import pickle
from dataclasses import dataclass

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm
from scipy.stats import t as student

import pgm

X, Y, Z, U = pgm.variables("x y z u")
M = pgm.Discrete("m", states=("a", "b"))
C = pgm.Discrete("c", states=("0", "1", "2"))
START = pgm.TableCPD(M, table=[0.4, 0.6])
STAY = pgm.TableCPD(M, given=(M.previous,), table=[[0.9, 0.1], [0.2, 0.8]])
WEIGHTS = {"a": [0.7, 0.2, 0.1], "b": [0.4, 0.6, 0.0]}
VALUES = np.array([[1.0], [4.0], [2.0]])
MANY = pgm.Gaussians(300)


def line(child, given, cov, offset=0.0, noise=None):
    return pgm.LinearGaussianCPD(child, given, cov=cov, offset=offset, noise=noise)


def wave(noise=None, cov=0.2):
    return pgm.NonlinearGaussianCPD(Z, X, lambda x: x + np.sin(x), cov=cov, noise=noise)


PARTS = {
    "prior": [pgm.GaussianCPD(X, 3.0 * k - 2.0, 0.5 + k) for k in range(5)],
    "motion": [line(X, {X.previous: 1.0 - 0.1 * k, U: 1.0}, 0.1 + k, 2.0 * k) for k in range(5)],
    "sensor": [line(Z, {X: 1.0}, 0.2 + 2.0 * k, 0.5 * k) for k in range(5)],
}


def modelled(parts, *causes):
    prior = [START, *(c for c in causes if c.child == C), parts["prior"]]
    motion = [STAY, *causes, parts["motion"]]
    return pgm.DynamicBayesianNetwork(prior, motion, [parts["sensor"]])


@pytest.mark.parametrize("place", ["prior", "motion", "sensor"])
def test_mixtures_by_mode_are_chosen_by_mode_and_cause(place):
    """The twin has a hidden variable for the component, whose table is the mode's weights."""
    alone = {name: own[0] for name, own in PARTS.items()}
    first, child = PARTS[place], PARTS[place][0].child
    mixtures = {
        "a": pgm.MixtureCPD(first[:3], WEIGHTS["a"]),
        "b": pgm.MixtureCPD(first[3:], WEIGHTS["b"][:2]),
    }
    chosen = pgm.SwitchingCPD(child, M, mixtures)
    cases = {("a", k): first[k] for k in range(3)} | {("b", k): first[3 + k] for k in (0, 1)}
    both = pgm.SwitchingCPD(child, (M, C), cases | {("b", 2): first[0]})
    cause = pgm.TableCPD(C, given=(M,), table=list(WEIGHTS.values()))
    given = {U: [[0.5], [-0.3], [0.1]], Z: VALUES}
    found = pgm.smooth(modelled(alone | {place: chosen}), given, belief=MANY)
    due = pgm.smooth(modelled(alone | {place: both}, cause), given, belief=MANY)
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)
    assert_allclose(found[X].mean, due[X].mean, atol=1e-11)
    assert_allclose(found[X].cov, due[X].cov, atol=1e-11)
    assert_allclose(found[M].probabilities, due[M].probabilities, atol=1e-12)


def test_a_mode_that_is_observed_chooses_a_mixture_of_motions():
    first, modes = PARTS["motion"], np.array([0, 1, 1])
    mixtures = {"a": pgm.MixtureCPD(first[:2], [0.5, 0.5]), "b": first[2]}
    chosen = pgm.SwitchingCPD(X, M, mixtures)
    both = pgm.SwitchingCPD(
        X,
        (M, C),
        {(m, k): first[2] if m == "b" else first[min(k, 1)] for m in "ab" for k in (0, 1, 2)},
    )
    cause = pgm.TableCPD(C, table=[0.5, 0.5, 0.0])
    prior, sensor = PARTS["prior"][0], PARTS["sensor"][0]
    given = {U: np.zeros((3, 1)), Z: VALUES, M: modes}
    model = pgm.DynamicBayesianNetwork([prior], [chosen], [sensor])
    twin = pgm.DynamicBayesianNetwork([prior, cause], [cause, both], [sensor])
    found, due = (pgm.smooth(each, given, belief=MANY) for each in (model, twin))
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)
    assert_allclose(found[X].mean, due[X].mean, atol=1e-11)


def test_mixtures_by_mode_without_time():
    """Enumerated by scipy: z has three densities of group a, and two of group b."""
    parts = PARTS["sensor"]
    mixtures = {
        "a": pgm.MixtureCPD(parts[:3], WEIGHTS["a"]),
        "b": pgm.MixtureCPD(parts[3:], WEIGHTS["b"][:2]),
    }
    net = pgm.BayesianNetwork([START, PARTS["prior"][0], pgm.SwitchingCPD(Z, M, mixtures)])
    found = pgm.infer(pgm.compile(net), {Z: [2.0]})
    weights = [*0.4 * np.array(WEIGHTS["a"]), *0.6 * np.array(WEIGHTS["b"][:2])]
    each = [norm.pdf(2.0, -2.0 + 0.5 * k, np.sqrt(0.7 + 2.0 * k)) for k in range(5)]
    share = np.array(weights) * each
    assert_allclose(found.log_evidence, np.log(share.sum()), rtol=1e-12)
    assert_allclose(found[M]["b"], share[3:].sum() / share.sum(), rtol=1e-12)


def moments(log_density):
    """The log of the integral of a density over x, and its mean, by the rectangle rule."""
    x = np.linspace(-60.0, 400.0, 230_001)
    logs = log_density(x)
    weights = np.exp(logs - logs.max())
    total = weights.sum()
    return logs.max() + np.log(total * (x[1] - x[0])), weights @ x / total


ROBUST = pgm.SwitchingCPD(
    Z, M, {"a": line(Z, {X: 1.0}, 0.1, noise=pgm.StudentT(4.0)), "b": line(Z, {X: 1.0}, 1.0, 1.0)}
)


def of_reading(value, mode):
    """The log-density of a reading given x in a mode, of `ROBUST`."""
    if mode == 0:
        return lambda x: student.logpdf((value - x) / np.sqrt(0.1), 4) - 0.5 * np.log(0.1)
    return lambda x: norm.logpdf(value, x + 1.0, 1.0)


def mixed(parts, weights):
    """The log-evidence, the probabilities of the modes, and the mean, of those of each mode."""
    logs = np.log(weights) + [log for log, _ in parts]
    total = np.logaddexp.reduce(logs)
    share = np.exp(logs - total)
    return total, share, share @ [mean for _, mean in parts]


def test_robust_cases_without_time_are_weighed_by_their_densities():
    """By quadrature; a second reading has robust noise whatever the mode is."""
    other = line(Y, {X: 1.0}, 0.2, noise=pgm.Cauchy(2.0))
    graph = pgm.compile(pgm.BayesianNetwork([START, pgm.GaussianCPD(X, 0.0, 1.0), ROBUST, other]))
    found = pgm.infer(graph, {Z: [5.0], Y: [0.3]})

    def joint(mode):
        seen = of_reading(5.0, mode)
        return moments(
            lambda x: norm.logpdf(x) + seen(x) + other.log_density([0.3], {X: x[:, None]})
        )

    total, share, mean = mixed([joint(0), joint(1)], [0.4, 0.6])
    assert_allclose(found.log_evidence, total, atol=1e-5)
    assert_allclose(found[M].probabilities, share, atol=1e-6)
    assert_allclose(found[X].mean, [mean], atol=1e-5)
    # There is nothing to weigh where the mode is known, and the noise is as it was.
    known = {Z: [5.0], Y: [0.3], M: "b"}
    found = pgm.infer(graph, known, schedule=pgm.Calibration(iterations=50))
    assert found.log_evidence_kind == "bound"


@pytest.mark.parametrize("value", [0.5, -6.0, 300.0])
def test_robust_cases_over_time(value):
    """One reading, of which all is exact, by quadrature."""
    model = pgm.DynamicBayesianNetwork(
        [START, pgm.GaussianCPD(X, 0.0, 0.5)], [STAY, line(X, {X.previous: 1.0}, 0.5)], [ROBUST]
    )
    found = pgm.filter(model, {Z: [[value]]}, belief=pgm.Gaussians(200))
    each = [of_reading(value, mode) for mode in (0, 1)]
    parts = [moments(lambda x, seen=seen: norm.logpdf(x) + seen(x)) for seen in each]
    total, share, mean = mixed(parts, np.array([0.4, 0.6]) @ STAY.table)
    assert_allclose(found.log_evidence, total, atol=1e-5)
    assert_allclose(found[M.at(1)].probabilities, share, atol=1e-6)
    assert_allclose(found[X.at(1)].mean, [mean], atol=1e-5)
    robot = pgm.OnlineFilter(model, belief=pgm.Gaussians(200))
    belief = robot.update(robot.predict(robot.initial()), {Z: [value]})
    assert_allclose(belief[X].mean, found[X.at(1)].mean, atol=1e-12)


def test_robust_noise_of_a_sensor_that_no_mode_chooses():
    """Of a long chain beside the grid's; three sightings of a step are each of a scale."""
    model = pgm.DynamicBayesianNetwork(
        [START, pgm.GaussianCPD(X, 0.0, 0.5)],
        [
            STAY,
            pgm.SwitchingCPD(
                X, M, {m: line(X, {X.previous: 1.0}, q) for m, q in {"a": 0.05, "b": 2.0}.items()}
            ),
        ],
        [line(Z, {X: 1.0}, 0.1, noise=pgm.StudentT(3.0))],
    )
    values, steps = np.array([[0.3], [0.1], [9.0], [0.4], [3.0], [3.2]]), [1, 1, 1, 2, 3, 4]
    given = {Z: pgm.sightings(values, step=steps)}
    found = pgm.smooth(model, given, steps=4, belief=pgm.Gaussians(12))
    x = np.linspace(-20.0, 20.0, 2001)
    width, path = x[1] - x[0], STAY.table
    moved = np.stack([norm.pdf(x[:, None], x, np.sqrt(q)) * width for q in (0.05, 2.0)])
    seen = np.ones((5, x.size))
    for value, step in zip(values[:, 0], steps, strict=True):
        seen[step] *= student.pdf((value - x) / np.sqrt(0.1), 3) / np.sqrt(0.1)
    ahead = [np.outer([0.4, 0.6], norm.pdf(x, 0.0, np.sqrt(0.5)))]
    for step in range(1, 5):
        ahead.append(np.einsum("sxy,sy->sx", moved, path.T @ ahead[-1]) * seen[step])
    back = [np.ones_like(ahead[0])]
    for step in range(4, 0, -1):
        back.insert(0, path @ np.einsum("sxy,sx->sy", moved, back[0] * seen[step]))
    joint = np.array(ahead) * back
    total = joint.sum(axis=(1, 2))
    assert_allclose(found.log_evidence, np.log(total[-1] * width), atol=0.06)
    assert_allclose(found[M].probabilities, joint.sum(axis=2) / total[:, None], atol=0.02)
    assert_allclose(found[X].mean[:, 0], joint.sum(axis=1) @ x / total, atol=0.03)


def test_nonlinear_cases_of_robust_noise_and_of_one_function():
    """Cases that differ in noise alone are runs of one function; each by itself says the same."""
    noises = {"a": (0.1, pgm.StudentT(4.0)), "b": (1.0, None)}
    shared = {m: wave(noise, cov) for m, (cov, noise) in noises.items()}
    one = shared["a"].function
    same = {
        m: pgm.NonlinearGaussianCPD(Z, X, one, cov=cov, noise=noise)
        for m, (cov, noise) in noises.items()
    }
    prior, motion = [START, pgm.GaussianCPD(X, 0.0, 0.5)], [STAY, line(X, {X.previous: 1.0}, 0.5)]
    found, due = (
        pgm.filter(
            pgm.DynamicBayesianNetwork(prior, motion, [pgm.SwitchingCPD(Z, M, cases)]),
            {Z: VALUES},
            lineariser=pgm.Unscented(),
        )
        for cases in (same, shared)
    )
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)
    assert_allclose(found[X].mean, due[X].mean, atol=1e-12)
    net = pgm.BayesianNetwork([START, prior[1], pgm.SwitchingCPD(Z, M, same)])
    twin = pgm.BayesianNetwork([START, prior[1], pgm.SwitchingCPD(Z, M, shared)])
    static = [pgm.infer(pgm.compile(each), {Z: [3.0]}) for each in (net, twin)]
    assert_allclose(static[0].log_evidence, static[1].log_evidence, rtol=1e-10)
    assert_allclose(static[0][X].mean, static[1][X].mean, rtol=1e-10)


def test_noise_by_inputs_is_scaled():
    """A robust noise whose matrix is a function of an input equals one of its numbers."""
    by_input = pgm.noise(lambda u: 0.1 * u[..., None], given=(U,))
    prior, motion = [START, pgm.GaussianCPD(X, 0.0, 0.5)], [STAY, line(X, {X.previous: 1.0}, 0.5)]

    def filtered(cov, given):
        sensor = pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=cov, noise=pgm.StudentT(4.0))
        cases = {"a": sensor, "b": line(Z, {X: 1.0}, 3.0)}
        model = pgm.DynamicBayesianNetwork(prior, motion, [pgm.SwitchingCPD(Z, M, cases)])
        return pgm.filter(model, {Z: VALUES, **given})

    found, due = filtered(by_input, {U: np.full((3, 1), 2.0)}), filtered(0.2, {})
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)
    assert_allclose(found[X].mean, due[X].mean, atol=1e-12)


@pytest.mark.parametrize("place", [0, 2, 4])
def test_an_outlier_among_a_step_s_readings_is_told_wherever_it_stands(place):
    """Five readings of a state that is hardly known before: by quadrature."""
    values = [1.0, 1.1, 0.9, 1.05]
    values.insert(place, -20.0)
    noise = pgm.StudentT(4.0)
    cases = {m: line(Z, {X: 1.0}, v, noise=noise) for m, v in {"a": 0.01, "b": 0.1}.items()}
    model = pgm.DynamicBayesianNetwork(
        [START, pgm.GaussianCPD(X, 0.0, 100.0)],
        [STAY, line(X, {X.previous: 1.0}, 0.0)],
        [pgm.SwitchingCPD(Z, M, cases)],
    )
    seen = {Z: pgm.sightings(np.array(values)[:, None], step=[1] * 5)}
    found = pgm.filter(model, seen, steps=1)

    def joint(cov):
        return moments(
            lambda x: (
                norm.logpdf(x, 0.0, 10.0)
                + sum(student.logpdf((z - x) / np.sqrt(cov), 4) - 0.5 * np.log(cov) for z in values)
            )
        )

    total, share, mean = mixed([joint(0.01), joint(0.1)], np.array([0.4, 0.6]) @ STAY.table)
    assert_allclose(found.log_evidence, total, atol=0.5)
    assert_allclose(found[M.at(1)].probabilities, share, atol=0.02)
    assert_allclose(found[X.at(1)].mean, [mean], atol=0.01)


@pytest.mark.parametrize("noise", [None, pgm.StudentT(4.0)], ids=repr)
def test_a_function_without_a_value_under_another_mode(noise):
    """Of a root that is NaN where the other mode's belief is."""
    prior = {"a": pgm.GaussianCPD(X, 5.0, 0.1), "b": pgm.GaussianCPD(X, -5.0, 0.1)}

    def root(sign, cov, noise=None):
        return pgm.NonlinearGaussianCPD(
            Z, X, lambda x: np.sqrt(np.where(sign * x > 0, sign * x, np.nan)), cov=cov, noise=noise
        )

    model = pgm.DynamicBayesianNetwork(
        [START, pgm.SwitchingCPD(X, M, prior)],
        [pgm.TableCPD(M, given=M.previous, table=np.eye(2)), line(X, {X.previous: 1.0}, 0.01)],
        [pgm.SwitchingCPD(Z, M, {"a": root(1.0, 0.1, noise), "b": root(-1.0, 0.5)})],
    )
    found = pgm.filter(model, {Z: [[2.2], [2.3], [2.1]]})
    alone = pgm.DynamicBayesianNetwork(
        [prior["b"]], [line(X, {X.previous: 1.0}, 0.01)], [root(-1.0, 0.5)]
    )
    due = np.log(0.6) + pgm.filter(alone, {Z: [[2.2], [2.3], [2.1]]}).log_evidence
    assert_allclose(found.log_evidence + np.log(found[M.at(3)]["b"]), due, rtol=1e-9)


def test_iterations_of_mixtures_are_told():
    wavy = lambda v: v + 0.3 * np.sin(2 * v)  # noqa: E731
    bent = [pgm.NonlinearGaussianCPD(Z, X, wavy, cov=v) for v in (0.1, 2.0)]
    model = pgm.DynamicBayesianNetwork(
        [START, pgm.GaussianCPD(X, 1.0, 0.5)],
        [STAY, line(X, {X.previous: 1.0}, 0.5)],
        [pgm.SwitchingCPD(Z, M, {"a": pgm.MixtureCPD(bent, [0.5, 0.5]), "b": bent[1]})],
    )
    with pytest.warns(pgm.ConvergenceWarning):
        found = pgm.filter(model, {Z: [[20.0]]}, iterations=20)
    assert not found.status.converged
    assert found.status.iterations == 20


def test_readings_beyond_robust_noise_are_refused():
    model = pgm.DynamicBayesianNetwork(
        [START, pgm.GaussianCPD(X, 0.0, 0.5)], [STAY, line(X, {X.previous: 1.0}, 0.5)], [ROBUST]
    )
    near = pgm.filter(model, {Z: [[1e5]]})
    assert near[M.at(1)]["a"] > 0.999
    with pytest.raises(pgm.NumericalError, match="more than a million deviations") as error:
        pgm.filter(model, {Z: [[1.0], [1e9]]})
    assert error.value.step == 2
    net = pgm.BayesianNetwork([START, pgm.GaussianCPD(X, 0.0, 1.0), ROBUST])
    with pytest.raises(pgm.NumericalError, match="more than a million deviations"):
        pgm.infer(pgm.compile(net), {Z: [1e9]})


def test_a_filter_and_its_belief_are_copied_together():
    motion = pgm.MixtureCPD(PARTS["motion"][:2], [0.5, 0.5])
    model = pgm.DynamicBayesianNetwork(
        [START, PARTS["prior"][0]],
        [STAY, pgm.SwitchingCPD(X, M, {"a": motion, "b": PARTS["motion"][2]})],
        [PARTS["sensor"][0]],
    )
    robot = pgm.OnlineFilter(model)
    belief = robot.update(robot.predict(robot.initial(), {U: [0.0]}), {Z: [0.3]})
    again, copied = pickle.loads(pickle.dumps((robot, belief)))
    found = again.predict(copied, {U: [0.0]})
    assert_allclose(found[X].mean, robot.predict(belief, {U: [0.0]})[X].mean)


@dataclass(frozen=True)
class Own(pgm.RobustNoise):
    """Student's loss of four degrees of freedom, for scalars, with a mixture as it is given."""

    mixture: object

    def loss(self, square, count):
        return 2.5 * np.log1p(square / 4.0)

    def slope(self, square, count):
        return 5.0 / (4.0 + square)

    def scales(self, size):
        return self.mixture


def with_noise(noise):
    cases = {"a": line(Z, {X: 1.0}, 0.1, noise=noise), "b": line(Z, {X: 1.0}, 1.0)}
    return pgm.DynamicBayesianNetwork(
        [START, pgm.GaussianCPD(X, 0.0, 0.5)],
        [STAY, line(X, {X.previous: 1.0}, 0.5)],
        [pgm.SwitchingCPD(Z, M, cases)],
    )


def test_scales_of_a_noise_of_one_s_own():
    students = pgm.StudentT(4.0)
    lists = tuple(part.tolist() for part in students.scales(1))
    found, due = (pgm.filter(with_noise(n), {Z: VALUES}) for n in (Own(lists), students))
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-9)
    for mixture, words in (
        (5, "weights and factors"),
        (((1.0,), (1.0,)), "where that of the loss is"),
        (((0.5, 0.5), (1.0, 0.0)), "positive factors"),
        (None, r"may have scales\(\)"),
    ):
        with pytest.raises(pgm.ModelError, match=words):
            pgm.filter(with_noise(Own(mixture)), {Z: VALUES})


def test_a_path_of_modes_and_an_audit_are_refused():
    prior, motion = [START, pgm.GaussianCPD(X, 0.0, 0.5)], [STAY, line(X, {X.previous: 1.0}, 0.5)]
    model = pgm.DynamicBayesianNetwork(prior, motion, [ROBUST])
    with pytest.raises(pgm.GraphError, match="on no path of discrete variables"):
        pgm.most_probable(pgm.compile(model, 3), {Z: VALUES})
    moved = pgm.MixtureCPD([motion[1], line(X, {X.previous: 1.0}, 9.0)], [0.9, 0.1])
    other = pgm.DynamicBayesianNetwork(prior, [STAY, moved], [ROBUST])
    with pytest.raises(pgm.GraphError, match="on no path of discrete variables"):
        pgm.most_probable(pgm.compile(other, 3), {Z: VALUES})
    with pytest.raises(pgm.ModelError, match="a mixture of several scales"):
        pgm.audit(pgm.smooth(model, {Z: VALUES}), rng=0)


@pytest.mark.parametrize(
    "noise", [pgm.Huber(1.5), pgm.StudentT(0.2), pgm.StudentT(100.0), pgm.Cauchy(1.01)], ids=repr
)
def test_robust_noise_that_is_no_mixture_of_scales_is_refused(noise):
    cases = {"a": line(Z, {X: 1.0}, 0.1, noise=noise), "b": line(Z, {X: 1.0}, 1.0)}
    sensor = pgm.SwitchingCPD(Z, M, cases)
    prior = pgm.GaussianCPD(X, 0.0, 1.0)
    model = pgm.DynamicBayesianNetwork([prior], [START, line(X, {X.previous: 1.0}, 1.0)], [sensor])
    with pytest.raises(pgm.ModelError, match=r"no mixture .*hypotheses of \(m\) are weighed"):
        pgm.filter(model, {Z: VALUES})
    with pytest.raises(pgm.ModelError, match=r"no mixture .*states of discrete variables"):
        pgm.infer(pgm.compile(pgm.BayesianNetwork([START, prior, sensor])), {Z: [1.0]})


def test_robust_noise_beside_sightings_without_identity_is_refused():
    sensor = line(Z, {Y: 1.0, X: -1.0}, 0.1, noise=pgm.StudentT(4.0))
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, 0.0, 1.0)], [line(X, {X.previous: 1.0}, 1.0)], [sensor]
    )
    seen = {Z: pgm.sightings([[2.0]], step=[1], given={Y: pgm.unknown([[2.0], [20.0]])})}
    with pytest.raises(pgm.ModelError, match=r"declare outliers by pgm\.unknown"):
        pgm.filter(model, seen, steps=1)
