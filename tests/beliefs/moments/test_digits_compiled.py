"""Passes in twice the digits by machine code against NumPy's, and against 60 digits."""

from importlib.util import find_spec

import mpmath
import numpy as np
import pytest
from crossed import crossed, slow_after
from drawn_chains import draw

import pgm
from pgm.beliefs.moments.digits import adjoint, careful, compiled
from pgm.beliefs.moments.digits.laid_out import flat
from pgm.beliefs.moments.digits.record import Record
from pgm.beliefs.moments.solvers import run

pytestmark = [
    pytest.mark.skipif(find_spec("llvmlite") is None, reason="llvmlite is not installed"),
    pytest.mark.filterwarnings("ignore::pgm.PrecisionWarning"),
    pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning"),
]

mp = mpmath.mp.clone()
mp.dps = 60
# Bounds of rounding are in float64, summed in another order, and some of them by cancelling.
BOUND = 0.1


class Passes:
    """The plans that were swept carefully, and what machine code has made of them."""

    def __init__(self, monkeypatch):
        self.swept, self.smoothed = [], []
        sweep, of = careful.sweep, adjoint.CarefulSmoothed.of.__func__
        self._numpy = sweep, of

        def kept(*given, **named):
            found = sweep(*given, **named)
            self.swept.append((given, named, found[0]))
            return found

        def kept_of(cls, plan, swept, lag=None):
            found = of(cls, plan, swept, lag)
            self.smoothed.append((plan, lag, found))
            return found

        monkeypatch.setattr(careful, "sweep", kept)
        monkeypatch.setattr(adjoint.CarefulSmoothed, "of", classmethod(kept_of))
        self._patch = monkeypatch

    def again(self):
        """The last passes by NumPy: forward, and smoothed, None if they were not."""
        given, named, _ = self.swept[-1]
        sweep, of = self._numpy
        with self._patch.context() as patch:
            patch.setattr(compiled, "sweep", lambda *_: None)
            forward = sweep(*given, **named)[0]
            if not self.smoothed:
                return forward, None
            plan, lag, _ = self.smoothed[-1]
            return forward, of(adjoint.CarefulSmoothed, plan, forward, lag)


@pytest.fixture
def passes(monkeypatch):
    return Passes(monkeypatch)


def assert_same(found, due):
    """The same pairs of float64 to the last bit, but for what underflows; bounds nearly so."""
    ours, others = flat(found), flat(due)
    assert [each.shape for each in ours] == [each.shape for each in others]
    for one, other in zip(ours, others, strict=True):
        np.testing.assert_allclose(one, other, rtol=0.0, atol=1e-290)


def assert_close(found, due):
    size = np.abs(due).max(initial=0.0)
    np.testing.assert_allclose(found, due, rtol=0.0, atol=BOUND * size + 1e-290)


def belief(found, due):
    assert_same((found.columns, found.cov, found.largest), (due.columns, due.cov, due.largest))
    assert_close(found.rounding, due.rounding)
    assert_close(found.drift, due.drift)


def assert_alike(passes):
    """Whether both ways have made the same of the last plan; False if machine code left it."""
    made = passes.swept[-1][2]
    if not isinstance(made.steps, Record):
        return False
    forward, smoothed = passes.again()
    for ours, other in zip(made.steps, forward.steps, strict=True):
        belief(ours.predicted, other.predicted)
        belief(ours.taken.belief, other.taken.belief)
        assert_same(ours.taken.information, other.taken.information)
        assert_same(ours.taken.unknown, other.taken.unknown)
        for one, two in zip(ours.taken.components, other.taken.components, strict=True):
            assert_same(one[:4], two[:4])
            assert_close(one.error, two.error)
            assert_close(one.blur, two.blur)
    for name in ("mean", "cov", "predicted_mean", "predicted_cov", "log_density"):
        np.testing.assert_array_equal(getattr(made.forward, name), getattr(forward.forward, name))
    np.testing.assert_allclose(made.error, forward.error, rtol=BOUND)
    if smoothed is not None:
        ours = passes.smoothed[-1][2]
        belief(ours.slices.belief, smoothed.slices.belief)
        assert_same(ours.slices.here[:2], smoothed.slices.here[:2])
        np.testing.assert_array_equal(ours.slices.lost, smoothed.slices.lost)
        np.testing.assert_array_equal(ours.beliefs.mean, smoothed.beliefs.mean)
        np.testing.assert_array_equal(ours.beliefs.cov, smoothed.beliefs.cov)
        np.testing.assert_allclose(ours.error, smoothed.error, rtol=BOUND)
    return True


def matrices(n, seed, *, units=1.0, sharp=1e-9, height=1):
    """F, Q, H, P and R of a chain of n components in units apart, and sharp readings."""
    rng = np.random.default_rng(seed)
    unit = units ** rng.uniform(-1.0, 1.0, n)
    moved = unit[:, None] * (np.eye(n) + 0.05 * rng.normal(size=(n, n))) / unit
    root = unit[:, None] * rng.normal(size=(n, n))
    seen = rng.normal(size=(height, n)) / unit
    noise = 0.1 * root @ root.T
    return moved, 0.5 * (noise + noise.T), seen, np.diag(unit**2), np.eye(height) * sharp**2


def network(numbers, *, flat_=False):
    """Its state, its measurement, and the network."""
    moved, noise, seen, prior, error = numbers
    n, height = len(moved), len(seen)
    x = pgm.Variable("x", components=tuple("abcdef"[:n]))
    z = pgm.Variable("z", components=tuple("abcdef"[:height]))
    prior = np.diag(np.full(n, np.inf)) if flat_ else prior
    return (
        x,
        z,
        pgm.DynamicBayesianNetwork(
            prior=[pgm.GaussianCPD(x, np.zeros(n), prior)],
            transition=[pgm.LinearGaussianCPD(x, {x.previous: moved}, cov=noise)],
            observation=[pgm.LinearGaussianCPD(z, {x: seen}, cov=error)],
        ),
    )


def drawn(seed, steps, height, runs=(), missing=0.0):
    rng = np.random.default_rng(seed)
    values = rng.normal(size=(*runs, steps, height))
    values[rng.random(values.shape) < missing] = np.nan
    return values


SCHEDULES = [pgm.Filtering(), pgm.Smoothing(), pgm.FixedLag(3)]


@crossed(
    ("case", "schedule"),
    [
        (1, 1, 1.0, False, (), 0.0),
        (3, 1, 1.0, False, (), 0.0),
        (3, 2, 1e6, True, (), 0.3),
        (2, 1, 1.0, True, (3,), 0.2),
        (2, 2, 1e3, True, (11,), 0.2),
        (4, 2, 1e3, False, (9,), 0.1),
    ],
    SCHEDULES,
)
def test_machine_code_is_numpys_pass(passes, case, schedule):
    """Flat priors, missing components, packs of runs; to the last bit of each pair."""
    steps, (n, height, units, flat_, runs, missing) = 12, case
    _, z, model = network(matrices(n, n, units=units, height=height), flat_=flat_)
    graph = pgm.compile(model, steps=steps, compiled=True)
    found = pgm.infer(graph, {z: drawn(1, steps, height, runs, missing)}, schedule=schedule)
    assert found.status.compilation.startswith("compiled")
    assert assert_alike(passes)


@pytest.mark.parametrize("seed", slow_after(8, range(40)))
def test_drawn_chains_are_swept_alike(passes, seed):
    """Singular, sharp, exact and repeated sensors, controls and units, right, refused or told."""
    case = draw(seed, 10)
    words = []
    for choice in (True, False):
        graph = pgm.compile(case.model, steps=case.steps, compiled=choice)
        try:
            pgm.infer(graph, case.evidence, schedule=pgm.Smoothing())
            words.append("")
            if choice and passes.swept:
                assert_alike(passes)
        except pgm.PgmError as error:
            words.append(str(error))
    assert words[0] == words[1]


def filtered(numbers, readings):
    """The filter in 60 digits: means, covariances and log-densities of each step, from 0."""
    moved, noise, seen, cov, error = (mp.matrix(each.tolist()) for each in numbers)
    mean, found = mp.zeros(moved.rows, 1), []
    for reading in readings:
        mean, cov = moved * mean, moved * cov * moved.T + noise
        spread = seen * cov * seen.T + error
        left = mp.matrix(reading.tolist()) - seen * mean
        gain = cov * seen.T * spread**-1
        mean, cov = mean + gain * left, cov - gain * spread * gain.T
        square = (left.T * spread**-1 * left)[0]
        density = -(square + mp.log(mp.det(spread)) + len(reading) * mp.log(2 * mp.pi)) / 2
        found.append((mean, cov, density))
    return found


@pytest.mark.parametrize(
    ("n", "height", "units", "sharp"),
    [
        (2, 1, 1.0, 1.0),
        (3, 2, 1.0, 1.0),
        (4, 1, 1.0, 0.1),
        (3, 2, 1e6, 1.0),
        (3, 1, 1.0, 1e-9),
        (3, 2, 1e6, 1e-6),
        (4, 2, 1e3, 1e-12),
    ],
)
def test_pairs_are_right_to_30_digits_or_as_told(passes, monkeypatch, n, height, units, sharp):
    """Of deviations; sharp readings cost the digits that the bound tells."""
    monkeypatch.setattr(run, "_suffices", lambda _: False)
    steps, numbers = 12, matrices(n, n, units=units, sharp=sharp, height=height)
    _, z, model = network(numbers)
    readings = drawn(2, steps, height)
    pgm.infer(
        pgm.compile(model, steps=steps, compiled=True), {z: readings}, schedule=pgm.Filtering()
    )
    made = passes.swept[-1][2]
    assert isinstance(made.steps, Record)
    allowed = 1e-30 if sharp >= 0.1 else max(1e-30, made.error[0])
    due = filtered(numbers, readings)
    for step, (mean, cov, density) in zip(list(made.steps)[1:], due, strict=True):
        columns, spread = step.taken.belief[:2]
        std = [mp.sqrt(cov[i, i]) for i in range(n)]
        for i in range(n):
            off = mp.mpf(columns.hi[0, i, 0]) + mp.mpf(columns.lo[0, i, 0]) - mean[i]
            assert abs(off) <= allowed * (std[i] + (abs(mean[i]) if sharp >= 0.1 else 0))
            for j in range(n):
                off = mp.mpf(spread.hi[0, i, j]) + mp.mpf(spread.lo[0, i, j]) - cov[i, j]
                assert abs(off) <= allowed * std[i] * std[j]
        assert abs(step.taken.log_density[0] - density) <= 1e-13 * (1 + abs(density))


@pytest.mark.parametrize("flat_", [True, False])
@pytest.mark.parametrize("schedule", SCHEDULES)
def test_a_chain_without_measurements(passes, monkeypatch, schedule, flat_):
    monkeypatch.setattr(run, "_suffices", lambda _: False)
    _, _, model = network(matrices(2, 0), flat_=flat_)
    found = pgm.infer(pgm.compile(model, steps=5, compiled=True), {}, schedule=schedule)
    assert found.status.compilation == "compiled"
    assert assert_alike(passes)


def told(model, evidence, **options):
    graph = pgm.compile(model, steps=12, compiled=True)
    return pgm.infer(graph, evidence, **options).status.compilation


def test_what_is_left_to_numpy_is_told():
    _, z, model = network(matrices(3, 0), flat_=True)
    evidence = {z: drawn(0, 12, 1)}
    words = told(model, evidence, schedule=pgm.Filtering(gate=0.999))
    assert words == "not compiled: float64 has too few digits, and gates reject sightings"


def robot(sharp):
    """README's robot, its sensor sharper."""
    x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
    u = pgm.Variable("u", components=("v", "omega"))
    z = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
    m = pgm.Variable("m", components=("east", "north"))

    def drive(x, u, dt=0.5):
        heading = x[..., 2] + 0.5 * dt * u[..., 1]
        step = dt * u[..., 0]
        change = [step * np.cos(heading), step * np.sin(heading), dt * u[..., 1]]
        return x + np.stack(change, axis=-1)

    def range_bearing(x, m):
        away = m - x[..., :2]
        bearing = np.arctan2(away[..., 1], away[..., 0]) - x[..., 2]
        return np.stack([np.hypot(away[..., 0], away[..., 1]), bearing], axis=-1)

    square = np.square
    moved, seen = square([0.05, 0.05, 0.03]), square([0.2 * sharp, 0.05 * sharp])
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, mean=[0, 0, 0], cov=square([0.1, 0.1, 0.05]))],
        transition=[pgm.NonlinearGaussianCPD(x, given=(x.previous, u), function=drive, cov=moved)],
        observation=[pgm.NonlinearGaussianCPD(z, given=(x, m), function=range_bearing, cov=seen)],
    )
    steps = np.arange(0, 61, 3)
    landmarks = np.tile([[7.0, 1.0], [-6.0, 8.0], [4.0, 12.0]], (7, 1))
    given = {m: landmarks}
    return x, model, {u: np.tile([1.0, 0.2], (60, 1)), z: pgm.sightings(step=steps, given=given)}


@crossed(
    ("sharp", "schedule", "runs"),
    [1.0, 1e-7],
    [pgm.Filtering(), pgm.Smoothing(), pgm.Smoothing(iterations=3), pgm.FixedLag(4)],
    [(), 9],
)
def test_functions_are_linearised_as_by_numpy(passes, monkeypatch, schedule, sharp, runs):
    """Angles that turn, and bearings on their branch; alike but for what a function rounds."""
    monkeypatch.setattr(run, "_suffices", lambda _: False)
    x, model, asked = robot(sharp)
    evidence = model.sample(asked, runs=runs, rng=1).evidence
    found, due = (
        pgm.infer(pgm.compile(model, steps=60, compiled=choice), evidence, schedule=schedule)
        for choice in (True, False)
    )
    assert isinstance(passes.swept[0][2].steps, Record)
    assert found.status.compilation.startswith("compiled")
    std = due[x].std
    np.testing.assert_array_less(np.abs(found[x].mean - due[x].mean) / std, 1e-10)
    np.testing.assert_allclose(found[x].std, std, rtol=1e-10)
    np.testing.assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-10)
    np.testing.assert_array_equal(found.status.converged, due.status.converged)


def test_robust_noise_counts_with_the_weights_that_were_found(passes, monkeypatch):
    """The filter that finds them is NumPy's, which is told; passes with them are compiled."""
    monkeypatch.setattr(run, "_suffices", lambda _: False)
    moved, noise, seen, prior, error = matrices(2, 4, sharp=0.5)
    x, z = pgm.Variable("x", components=("a", "b")), pgm.Variable("z", components=("a",))
    sensor = pgm.LinearGaussianCPD(z, {x: seen}, cov=error, noise=pgm.StudentT(4.0))
    model = pgm.DynamicBayesianNetwork(
        prior=[pgm.GaussianCPD(x, np.zeros(2), prior)],
        transition=[pgm.LinearGaussianCPD(x, {x.previous: moved}, cov=noise)],
        observation=[sensor],
    )
    found, due = (
        pgm.infer(
            pgm.compile(model, steps=20, compiled=choice),
            {z: drawn(3, 20, 1)},
            schedule=pgm.Smoothing(iterations=4),
        )
        for choice in (True, False)
    )
    assert "robust noise" in found.status.compilation
    assert any(isinstance(each[2].steps, Record) for each in passes.swept)
    np.testing.assert_allclose(found[x].mean, due[x].mean, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-12)
