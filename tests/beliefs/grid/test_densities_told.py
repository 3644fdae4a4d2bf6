"""Densities on a grid: what leaves, what is too narrow, what is no density, what is refused."""

import warnings

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import cauchy, laplace, norm, uniform

import pgm

x, z, c = pgm.variables("x z c")
READ = {z: [[0.3], [0.1]]}


def moved(density, **about):
    return pgm.SampledCPD(
        x, x.previous, log_density=lambda y, b: density.logpdf((y - b)[..., 0], **about)
    )


def model(**other):
    parts = {
        "prior": [pgm.GaussianCPD(x, 0.05, 0.01)],
        "transition": [moved(laplace, scale=0.4)],
        "observation": [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.25)],
    } | other
    return pgm.DynamicBayesianNetwork(**parts)


def line(cells=100, reach=5.0):
    return pgm.Grid({"x": (-reach, reach, cells)})


def predicted(net, grid):
    robot = pgm.OnlineFilter(net, belief=grid)
    return robot.predict(robot.initial())


@pytest.mark.parametrize(
    ("density", "about", "rough"),
    [
        (laplace, {"loc": 3.0, "scale": 0.4}, 0.005),
        (norm, {"loc": 4.0, "scale": 0.5}, 5e-4),
        (cauchy, {"scale": 0.3}, 1e-5),  # beyond what is looked at outside the bounds, too
        (uniform, {"loc": 2.0, "scale": 4.0}, 0.02),
        (norm, {"loc": 100.0, "scale": 3.0}, 1e-9),
    ],
)
def test_what_leaves_is_counted_and_warned_of(density, about, rough):
    still = model(prior=[pgm.GaussianCPD(x, 0.05, 0.0)], transition=[moved(density, **about)])
    due = 1.0 - (density.cdf(4.95, **about) - density.cdf(-5.05, **about))
    if due == 1.0:
        with pytest.raises(pgm.NumericalError, match="all probability has left"):
            predicted(still, line())
        return
    with pytest.warns(pgm.GridWarning, match="left the bounds"):
        found = predicted(still, line())
    assert_allclose(found.status.outside, due, atol=rough)


def test_a_part_that_goes_far_away_is_counted():
    """Its density is seen nowhere near the bounds."""

    def away(y, b):
        gap = (y - b)[..., 0]
        return np.logaddexp(norm.logpdf(gap) + np.log(0.8), norm.logpdf(gap, 300.0) + np.log(0.2))

    far = model(transition=[pgm.SampledCPD(x, x.previous, log_density=away)])
    with pytest.warns(pgm.GridWarning, match="left the bounds"):
        found = predicted(far, line(reach=20.0))
    assert_allclose(found.status.outside, 0.2, atol=1e-9)


def test_a_prior_beyond_the_bounds():
    half = model(prior=[pgm.SampledCPD(x, log_density=lambda y: norm.logpdf(y[..., 0], 4.0))])
    with pytest.warns(pgm.GridWarning, match="left the bounds"):
        found = pgm.OnlineFilter(half, belief=line()).initial()
    assert_allclose(found.status.outside, norm.sf(1.0), atol=5e-4)
    most = model(prior=[pgm.SampledCPD(x, log_density=lambda y: norm.logpdf(y[..., 0], 6.0))])
    with pytest.raises(pgm.ModelError, match="of its probability inside the grid"):
        pgm.OnlineFilter(most, belief=line()).initial()


def test_a_flat_prior_within_the_bounds_is_flat():
    flat = pgm.SampledCPD(
        x, log_density=lambda y: np.where(np.abs(y[..., 0]) < 5, -np.log(10.0), -np.inf)
    )
    found = pgm.OnlineFilter(model(prior=[flat]), belief=line()).initial()
    assert_allclose(found[x].values, 0.01, rtol=1e-12)
    assert found.status.outside < 1e-12


@pytest.mark.parametrize(("cells", "told"), [(0.42, "warned"), (0.55, "told"), (1.5, "even")])
def test_a_density_that_is_narrow_for_the_cells_is_told(cells, told):
    still = model(transition=[moved(norm, scale=0.1 * cells)])
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = predicted(still, line()).status
    assert_allclose(
        found.uneven.share, 4.0 * np.exp(-2.0 * np.pi**2 * cells**2), rtol=0.05, atol=1e-9
    )
    assert bool(caught) == (told == "warned") == found.rough
    assert all("narrow for the cells" in str(each.message) for each in caught)
    assert ("uneven by" in repr(found)) == (told != "even")
    assert found.outside < 1e-9  # normalised all the same


@pytest.mark.parametrize("scale", [0.3, 0.1, 0.03])
@pytest.mark.parametrize("offset", [0.0, 0.1, 0.25, 0.5])
def test_a_density_between_the_centres_is_refused(scale, offset):
    narrow = model(transition=[moved(norm, loc=0.1 * offset, scale=0.1 * scale)])
    with pytest.raises(pgm.ModelError, match="too narrow for the cells at step 1"):
        predicted(narrow, line())
    # As a Gaussian CPD it is moved exactly, in a mixture too.
    exact = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, offset=0.1 * offset, cov=(0.1 * scale) ** 2)
    found = predicted(model(transition=[pgm.MixtureCPD([exact, exact], [0.5, 0.5])]), line())
    assert_allclose(found[x].mean, [0.05 + 0.1 * offset], atol=1e-9)


def test_what_is_no_density():
    twice = model(
        transition=[pgm.SampledCPD(x, x.previous, log_density=lambda y, b: -np.abs(y - b)[..., 0])]
    )
    with pytest.raises(pgm.ModelError, match=r"an integral of 2\.0.* it is no density"):
        predicted(twice, line(reach=20.0))
    absent = pgm.SampledCPD(x, log_density=lambda y: np.full(y.shape[:-1], np.nan))
    with pytest.raises(pgm.LinearisationError, match="NaN or plus infinity"):
        pgm.OnlineFilter(model(prior=[absent]), belief=line()).initial()


def test_what_has_no_density_is_refused():
    drawn = pgm.SampledCPD(
        x, x.previous, sample=lambda b, size, rng: b + rng.normal(size=(*size, 1))
    )
    for net in (
        model(transition=[drawn]),
        model(transition=[pgm.MixtureCPD([drawn, model().transition[0]], [0.5, 0.5])]),
    ):
        with pytest.raises(pgm.ModelError, match=r"no density.* give it log_density="):
            pgm.filter(net, READ, belief=line())


def test_hidden_controls_and_memory():
    push = pgm.GaussianCPD(c, 0.0, 0.1)
    pushed = pgm.SampledCPD(x, (x.previous, c), log_density=lambda y, b, c: 0.0 * y[..., 0])
    with pytest.raises(pgm.ModelError, match="depends on c, a hidden control"):
        pgm.filter(model(transition=[push, pushed]), READ, belief=line())
    odd = pgm.SampledCPD(c, log_density=lambda y: norm.logpdf(y[..., 0]))
    by_odd = pgm.LinearGaussianCPD(x, {x.previous: 1.0, c: 1.0}, cov=0.1)
    with pytest.raises(pgm.ModelError, match="make it a state"):
        pgm.filter(model(transition=[odd, by_odd]), READ, belief=line())
    # A control of the Gaussian parts of a mixture is summed over.
    both = pgm.MixtureCPD(
        [by_odd, pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.1)], [0.5, 0.5]
    )
    found = pgm.filter(model(transition=[push, both]), READ, belief=line())
    wide = pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=0.2)
    due = model(transition=[pgm.MixtureCPD([wide, both.parts[1]], [0.5, 0.5])])
    assert_allclose(found[x].mean, pgm.filter(due, READ, belief=line())[x].mean, atol=1e-6)
    with pytest.raises(pgm.ModelError, match=r"the density of \[x\] from each of .* would take"):
        pgm.filter(model(prior=[pgm.GaussianCPD(x, 0.0, 1.0)]), READ, belief=line(1_000_000))


def test_evidence_for_a_place_that_was_cut_off_is_told():
    known = pgm.SampledCPD(z, x, log_density=lambda c, y: norm.logpdf((c - y)[..., 0], scale=0.3))
    gone = model(transition=[moved(norm, scale=0.3)], observation=[known])
    with pytest.warns(pgm.GridWarning, match="had been cut off"):
        found = pgm.filter(gone, {z: [[0.0], [15.0]]}, belief=line(400, 20.0))
    assert found.status.cut.share > 0.5
    assert found.status.cut.step == 2


def test_a_sharp_sensor_is_told():
    for density, due in ((norm, 5.0), (laplace, np.sqrt(2.0 / 0.2))):
        sharp = pgm.SampledCPD(
            z, x, log_density=lambda c, y, d=density: d.logpdf((c - y)[..., 0], scale=0.02)
        )
        with pytest.warns(pgm.GridWarning, match="too sharp for the cells"):
            found = pgm.filter(model(observation=[sharp]), {z: [[0.05]]}, belief=line())
        assert_allclose(found.status.sharpest.cells, due, rtol=1e-6)
        assert found.status.sharp == z


class Scan(pgm.SampledCPD):
    """Independent beams, of which some may be missing."""

    partial = True


BEAMS = np.linspace(0.5, 2.0, 180)
scan = pgm.Variable("scan", components=tuple(f"beam {k}" for k in range(180)))


def test_a_scan_is_weighed_some_cells_at_a_time():
    asked = []

    def beams(found, place):
        asked.append(found.shape)
        log = norm.logpdf(found - BEAMS * place, scale=5.0)
        return np.where(np.isnan(found), 0.0, log).sum(axis=-1)

    read = BEAMS * 0.4 + np.random.default_rng(0).normal(size=(2, 180)) * 5.0
    read[0, 30:] = np.nan
    read[1, 1::2] = np.nan
    net = model(observation=[Scan(scan, x, log_density=beams)])
    cells = 7000
    grid = line(cells)
    found = pgm.filter(
        net.replace(transition=[pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1.0)]),
        {scan: read},
        belief=grid,
    )
    assert max(np.prod(shape) for shape in asked) <= 2**20
    linear = pgm.LinearGaussianCPD(scan, {x: BEAMS[:, None]}, cov=25.0 * np.eye(180))
    due = pgm.filter(
        model(
            transition=[pgm.LinearGaussianCPD(x, {x.previous: 1.0}, cov=1.0)], observation=[linear]
        ),
        {scan: read},
    )
    assert_allclose(found[x].mean, due[x].mean, atol=1e-8)
    assert_allclose(found.log_evidence, due.log_evidence, rtol=1e-9)
    # A mixture of Gaussians leaves components out too; another density cannot.
    twice = pgm.MixtureCPD([linear, linear], [0.5, 0.5])
    few = pgm.filter(net.replace(observation=[twice]), {scan: read}, belief=line(200))
    plain = pgm.filter(net.replace(observation=[linear]), {scan: read}, belief=line(200))
    assert_allclose(few.log_evidence, plain.log_evidence, rtol=1e-9)
    whole = pgm.SampledCPD(scan, x, log_density=beams)
    with pytest.raises(pgm.EvidenceError, match="at step 1 has components that are NaN"):
        pgm.filter(net.replace(observation=[whole]), {scan: read}, belief=line(200))
