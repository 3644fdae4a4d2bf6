"""Monte Carlo errors of oracles, repeated with other seeds beside a grid; and weak oracles."""

import numpy as np
import pytest
from crossed import slow_after
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm import examples
from tests.beliefs.own.ensemble import EnsembleKalman

T = 5
a, z = pgm.Variable("a"), pgm.Variable("z")
STEPS = np.arange(T + 1)
FINE = pgm.Grid({"a": (-7.0, 7.0, 560)})
READ = {z: pgm.sightings(np.linspace(0.2, 1.0, T + 1)[:, None], step=STEPS)}


def bent(curve, noise=0.5):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, [1.0], 1.0)],
        [pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.2)],
        [pgm.NonlinearGaussianCPD(z, a, lambda a: a + curve * a**2, cov=noise)],
    )


def answers(model):
    return {
        "Taylor": pgm.smooth(model, READ, steps=T),
        "unscented": pgm.smooth(model, READ, steps=T, lineariser=pgm.Unscented()),
    }


def judged(model, rows, oracle):
    return pgm.compare(model, READ, rows=rows, oracle=oracle, steps=T)


@pytest.mark.parametrize(
    ("kind", "curve"),
    slow_after(2, [("audit", 0.1), ("particles", 0.3), ("audit", 0.3), ("particles", 0.1)]),
)
@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
def test_errors_cover_the_truth_with_other_seeds(kind, curve):
    """At least 90 % of intervals of 95 %, where Pareto shapes are below .7 and rows unmarked."""
    model = bent(curve)
    rows = answers(model)
    due = judged(model, rows, FINE)
    seeds = 60 if kind == "audit" else 40
    held, every, spread = [], [], {name: [] for name in rows}
    for seed in range(seeds):
        if kind == "audit":
            oracle = pgm.audit(rows["Taylor"], samples=600, rng=seed)
            assert oracle.pareto_k < 0.7
        else:
            oracle = pgm.Particles(400, seed=100 * seed)
        found = judged(model, rows, oracle)
        for name in rows:
            row, true = found[name], due[name]
            held.append(abs(row.kl - true.kl) <= 1.96 * row.kl_error)
            off = np.abs(row.kl_by_step - true.kl_by_step)
            every.append(off <= 1.96 * row.kl_error_by_step)
            spread[name].append((row.kl, row.kl_error))
    assert np.mean(held) >= 0.9
    assert np.mean(every) >= 0.9
    for name, each in spread.items():
        values, errors = np.array(each).T
        assert np.median(errors) < 2.0 * values.std()  # nor are they too wide
        assert values.mean() == pytest.approx(due[name].kl, abs=3 * values.std() / np.sqrt(seeds))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::pgm.ConvergenceWarning")
def test_errors_cover_by_pareto_shape():
    """Forty chains of random curvature, three proposals, ten seeds of each; as the guide says."""
    rng = np.random.default_rng(5)
    fine, found = pgm.Grid({"a": (-9.0, 9.0, 900)}), []
    steps = np.arange(5)
    for problem in range(40):
        curve, q, r = rng.uniform(0.0, 1.5), rng.uniform(0.05, 0.5), rng.uniform(0.1, 1.0)
        model = pgm.DynamicBayesianNetwork(
            [pgm.GaussianCPD(a, [0.5], 1.0)],
            [pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=q)],
            [pgm.NonlinearGaussianCPD(z, a, lambda a, c=curve: a + c * a**2 / 2.0, cov=r)],
        )
        drawn = model.sample({z: pgm.sightings(step=steps)}, steps=4, rng=problem)
        read = {z: pgm.sightings(drawn[z], step=steps)}
        settings = {"lineariser": pgm.Unscented()}, {"iterations": 20}
        proposals = [pgm.smooth(model, read, steps=4, **each) for each in ({}, *settings)]
        rows = dict(zip(("Taylor", "unscented"), proposals, strict=False))
        due = pgm.compare(model, read, rows=rows, oracle=fine, steps=4)
        for seed in range(30):
            audit = pgm.audit(proposals[seed % 3], samples=1000, rng=seed)
            judged = pgm.compare(model, read, rows=rows, oracle=audit, steps=4)
            for name in rows:
                row = judged[name]
                held = abs(row.kl - due[name].kl) <= 1.96 * row.kl_error
                found.append((float(audit.pareto_k), held, bool(row.weak)))
    shape, held, weak = np.array(found, dtype=float).T
    for low, high in ((-np.inf, 0.3), (0.3, 0.5), (0.5, 0.7)):
        some = (shape > low) & (shape <= high)
        print(f"{low} to {high}: {held[some].mean():.3f} of {some.sum()}")
        assert held[some].mean() >= 0.9
    assert (weak[shape > 0.7] == 1.0).all()


def test_errors_of_means_are_those_of_runs():
    """Of runs with draws of their own less by a root of their number; not of a shared oracle."""
    model = bent(0.1)
    values = np.broadcast_to(READ[z].values, (4, T + 1, 1))
    many = {z: pgm.sightings(values, step=STEPS)}
    one, four = pgm.smooth(model, READ, steps=T), pgm.smooth(model, many, steps=T)
    shared = pgm.audit(one, samples=600, rng=0)
    single = judged(model, {"Taylor": one}, shared)["Taylor"]
    found = pgm.compare(model, many, rows={"Taylor": four}, oracle=shared, steps=T)["Taylor"]
    assert_allclose(found.kl_by_step, single.kl_by_step, atol=1e-9)
    assert_allclose(found.kl_error, single.kl_error, rtol=1e-6)
    own = pgm.audit(four, samples=600, rng=0)
    apart = pgm.compare(model, many, rows={"Taylor": four}, oracle=own, steps=T)["Taylor"]
    assert apart.kl_error == pytest.approx(single.kl_error / 2.0, rel=0.5)


def test_particles_are_pooled_over_seeds():
    """The moments of all particles together, less the bias; a posterior's as a family's."""
    model = bent(0.1)
    rows, cloud = answers(model), pgm.Particles(500, seed=3)
    found = judged(model, rows, cloud)
    again = [
        pgm.smooth(model, READ, steps=T, belief=pgm.Particles(500, seed=3 + k)) for k in range(8)
    ]
    mean = np.mean([p[a].mean for p in again], axis=0)
    square = np.mean([p[a].cov + p[a].mean[..., None] ** 2 for p in again], axis=0)
    pooled = pgm.Gaussian(a, mean, square - mean[..., None] ** 2, steps=STEPS)
    plain = pgm.consistency.kl(pooled, rows["Taylor"][a])
    row = found["Taylor"]
    assert (row.kl_by_step < plain).all()  # the bias is subtracted
    assert_allclose(row.kl_by_step, plain, atol=0.01)
    given = judged(model, rows, again[0])["Taylor"]
    assert_allclose(given.kl_by_step, row.kl_by_step, atol=1e-12)
    assert given.kl_error == pytest.approx(row.kl_error)
    filtered = {"Taylor": pgm.filter(model, READ, steps=T)}
    forward = judged(model, filtered, again[0])["Taylor"]
    due = judged(model, filtered, cloud)["Taylor"]
    assert_allclose(forward.kl, due.kl, atol=1e-12)
    few = pgm.compare(model, READ, rows=rows, oracle=cloud, repeats=4, steps=T)["Taylor"]
    assert few.kl_error > 0.0


x = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
m = pgm.Variable("m", components=("east", "north"))


def drive(x):
    heading = x[..., 2]
    return x + 0.5 * np.stack([np.cos(heading), np.sin(heading), 0.2 + 0 * heading], axis=-1)


def distance(x, m):
    return np.linalg.norm(m - x[..., :2], axis=-1, keepdims=True)


@pytest.mark.filterwarnings("ignore::pgm.ParticleWarning", "ignore::pgm.ConvergenceWarning")
def test_a_smoother_of_few_particles_is_marked():
    """5,000 of them, begun wide and read sharply: right answers look half a nat off."""
    model = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [0, 0, 0], np.square([3.0, 3.0, 1.5]))],
        [pgm.NonlinearGaussianCPD(x, x.previous, drive, cov=np.square([0.05, 0.05, 0.03]))],
        [pgm.NonlinearGaussianCPD(z, (x, m), distance, cov=0.3**2)],
    )
    step = np.repeat(np.arange(9), 3)
    beacons = np.tile([[5.0, 3.0], [-4.0, 5.0], [1.0, -6.0]], (9, 1))
    drawn = model.sample({z: pgm.sightings(step=step, given={m: beacons})}, steps=8, rng=0)
    read = {z: pgm.sightings(drawn[z], step=step, given={m: beacons})}
    settings = {"iterations": 50, "damping": pgm.LevenbergMarquardt()}
    best = pgm.smooth(model, read, steps=8, **settings)
    rows = {"best": best, "Taylor": pgm.smooth(model, read, steps=8)}
    audit = pgm.audit(best, samples=2000, rng=0)
    cloud = pgm.smooth(model, read, steps=8, belief=pgm.Particles(5000, seed=0))
    naive = pgm.consistency.kl(cloud[x].gaussian(), best[x]).mean()
    found = pgm.compare(model, read, rows=rows, oracle={"audit": audit, "cloud": cloud}, steps=8)
    row = found["best"]
    assert row.kl < 0.005 < 0.1 < naive
    assert row.weak == found["Taylor"].weak == ""
    assert "runs with other seeds differ" in row.by_oracle["cloud"].weak
    told = " ".join(repr(found).split())
    assert "? cloud is too weak for best, smoothed, x; Taylor, smoothed, x" in told
    (own,) = [each for each in found.oracle_rows if each.lineariser == "oracle: cloud"]
    apart = own.by_oracle["audit"]
    assert apart.error > 10 * row.kl  # the oracles' disagreement is not known any better


def test_rows_that_an_oracle_cannot_tell_apart_are_marked():
    model = bent(0.1)
    rows = answers(model) | {"Taylor again": pgm.smooth(model, READ, steps=T)}
    close = pgm.smooth(bent(0.1, 0.5001), READ, steps=T)
    weak = pgm.audit(rows["Taylor"], samples=60, rng=0)
    found = judged(model, rows | {"close": close}, weak)
    assert found["Taylor"].weak  # from the one that is close, not from the same again
    found = judged(model, rows, pgm.audit(rows["Taylor"], samples=4000, rng=0))
    assert [row.weak for row in found.rows] == [""] * 3
    alone = judged(model, {"unscented": rows["unscented"]}, pgm.Particles(100, seed=0))
    assert "and the KL itself is" in alone["unscented"].weak
    linear = pgm.smooth(bent(0.0), READ, steps=T)
    pair = {"one": linear, "two": linear}
    found = judged(bent(0.0), pair, pgm.Particles(200))
    assert "differences between rows are" in found["one"].weak


def test_an_audit_that_is_not_trusted_marks_its_rows():
    model = bent(1.5, 0.02)
    rows = answers(model)
    audit = pgm.audit(rows["unscented"], samples=40, rng=0)
    assert not audit.trusted
    found = judged(model, rows, audit)
    assert {row.weak[:32] for row in found.rows} == {"an audit that is not trusted: Par"[:32]}
    assert "?" in repr(found)


@pytest.mark.filterwarnings("ignore::pgm.GridWarning")
def test_oracles_that_disagree_mark_rows_that_are_nearer():
    model = bent(0.1)
    rows = answers(model)
    off = pgm.Grid({"a": (-1.5, 1.2, 60)})  # cuts a part of the belief off
    found = pgm.compare(model, READ, rows=rows, oracle={"fine": FINE, "cut": off}, steps=T)
    assert "the oracle cut is" in found["unscented"].weak
    assert found.oracles == ("fine", "cut")
    fine, cut = found.oracle_rows
    p, q = (pgm.smooth(model, READ, steps=T, belief=grid)[a].gaussian() for grid in (FINE, off))
    assert_allclose(cut.by_oracle["fine"].kl_by_step, pgm.consistency.kl(p, q), rtol=1e-9)
    assert_allclose(fine.by_oracle["cut"].kl_by_step, pgm.consistency.kl(q, p), rtol=1e-9)
    assert_array_equal(fine.by_oracle["fine"].error_by_step, np.nan)
    assert cut.by_oracle["fine"].error == 0.0


def test_the_frame_has_errors_and_marks():
    pytest.importorskip("pandas")
    model = bent(0.1)
    rows = answers(model)
    audit = pgm.audit(rows["Taylor"], samples=400, rng=0)
    frame = judged(model, rows, audit).to_frame()
    assert (frame["kl_error"][:2] > 0.0).all()
    assert frame["weak"].tolist()[:2] == ["", ""]
    both = judged(model, rows, [FINE, audit]).to_frame()
    assert both["kl_error_Grid"].tolist()[:2] == [0.0, 0.0]
    assert both["kl_Audit"].tolist()[:2] == frame["kl"].tolist()[:2]


class Reseeded(EnsembleKalman):
    """A family of one's own that can be given another seed."""

    def with_seed(self, seed):
        return Reseeded(self.n, seed)


def test_a_family_of_ones_own_is_run_with_other_seeds_where_it_can_be():
    given = {examples.z: [[2.0], [3.0]]}
    rows = {"exact": pgm.smooth(examples.walk, given)}
    found = pgm.compare(examples.walk, given, rows=rows, oracle=Reseeded(400))["exact"]
    assert 0.0 < found.kl_error < 0.02
    assert abs(found.kl) < 3 * found.kl_error
    plain = pgm.compare(examples.walk, given, rows=rows, oracle=EnsembleKalman(400))
    assert np.isnan(plain["exact"].kl_error)
    assert "nothing tells the oracle's own error" in plain["exact"].weak
    assert "? EnsembleKalman is too weak for exact, smoothed, x" in repr(plain)


def test_oracles_that_differ_are_both_marked():
    """An audit that has missed a mode of 2 % of the mass, beside a grid."""
    x = pgm.Variable("x")
    walk = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1.0)
    read = pgm.NonlinearGaussianCPD(z, x, lambda x: x**2, cov=0.5)
    model = pgm.DynamicBayesianNetwork([pgm.GaussianCPD(x, 2.0, 1.0)], [walk], [read])
    evidence = {z: [[4.0], [9.0], [4.0]]}
    iterated = pgm.smooth(model, evidence, iterations=10)
    audit = pgm.audit(iterated, rng=0)
    assert audit.trusted
    oracles = {"audit": audit, "grid": pgm.Grid({"x": (-10.0, 10.0, 800)})}
    rows = {"estimate": pgm.estimate(model, evidence), "iterated": iterated}
    found = pgm.compare(model, evidence, rows=rows, oracle=oracles)
    for name in rows:
        assert "the oracle grid is" in found[name].by_oracle["audit"].weak
    assert "the oracle audit is" in found["estimate"].by_oracle["grid"].weak


SQUARED = {examples.z: [[9.0], [4.0]]}


def test_an_estimate_marks_what_is_within_its_bound():
    """The row of itself, and one a little off; not that which has one mode of two."""
    estimate = pgm.estimate(examples.squares, SQUARED)
    within = float(estimate.verdict.within)
    assert estimate.verdict.vouched
    own = estimate[examples.x].gaussian()
    # KL of a Gaussian with its mean moved by m deviations is m²/2.
    near, far = (
        pgm.Gaussian(
            examples.x,
            own.mean + np.sqrt(2.0 * share * within * own.cov[..., 0]),
            own.cov,
            steps=own.steps,
        )
        for share in (0.9, 1.1)
    )
    rows = {"itself": estimate, "near": near, "far": far}
    found = pgm.compare(examples.squares, SQUARED, rows=rows, oracle={"best": estimate})
    assert found["near"].kl == pytest.approx(0.9 * within)
    for name in ("itself", "near"):
        assert "within which the estimate is known" in found[name].weak
    assert found["far"].weak == ""
    assert found.oracle_status.startswith(estimate.verdict.headline)
    assert "? best is too weak for itself, smoothed, x; near" in repr(found)


def test_an_estimate_of_several_runs_marks_by_run():
    """The bound of each run is that run's: one that is far off does not hide one that is not."""
    many = {examples.z: [[[9.0], [4.0]], [[0.1], [0.2]]]}
    estimate = pgm.estimate(examples.squares, many)
    assert estimate.verdict.vouched.all()
    own = estimate[examples.x].gaussian()
    off = np.array([3.0, 0.0])[:, None, None]
    row = pgm.Gaussian(examples.x, own.mean + off, own.cov, steps=own.steps)
    found = pgm.compare(examples.squares, many, rows={"off": row}, oracle=estimate)["off"]
    assert found.kl > estimate.verdict.within.max()
    assert "in 1 of 2 runs" in found.weak


def test_an_estimate_that_is_not_vouched_for_marks_every_row():
    """Of few draws; and with a flat prior, of which none are weighed: a Gaussian by itself."""
    model = bent(0.3)
    flat = model.replace(prior=[pgm.GaussianCPD(a, 0.0, np.inf)])
    for each in (model, flat):
        estimate = pgm.estimate(each, READ, steps=T, effort=40)
        assert not estimate.verdict.vouched
        found = judged(each, answers(model), estimate)
        assert [each.weak for each in found.rows] == [
            f"an estimate that is {estimate.verdict.headline}"
        ] * 2


def test_an_oracle_that_is_not_exact_and_has_no_verdict_marks_every_row():
    """A linearised smoother's; a grid marks none."""
    model = bent(0.3)
    iterated = pgm.smooth(model, READ, steps=T, iterations=20)
    assert iterated.log_evidence_kind == "laplace"
    found = judged(model, answers(model), iterated)
    for row in found.rows:
        assert row.weak == "its beliefs are approximate (laplace), and nothing tells by how much"
    assert [row.weak for row in judged(model, answers(model), FINE).rows] == ["", ""]


def test_an_exact_estimate_marks_nothing():
    given = {examples.z: [[2.0], [3.0]]}
    exact = pgm.estimate(examples.walk, given)
    off = pgm.Gaussian(examples.x, exact[examples.x].mean + 1e-3, exact[examples.x].cov)
    rows = {"same": pgm.smooth(examples.walk, given), "off": off}
    found = pgm.compare(examples.walk, given, rows=rows, oracle=exact)
    assert [row.weak for row in found.rows] == ["", ""]
    assert found["same"].kl_error == found["off"].kl_error == 0.0
