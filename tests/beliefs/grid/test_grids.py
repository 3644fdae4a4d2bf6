"""Grids as values, their beliefs, their status, and what is refused."""

import copy
import pickle
import warnings

import numpy as np
import pytest
from grid.sighted import evidence, grid, m, robot, sight, u, x, z
from numpy.testing import assert_allclose, assert_array_equal

import pgm
from pgm.errors import EvidenceError, GraphError, LinearisationError, ModelError, NumericalError

KNOWN = np.diag([0.1, 0.1, 0.05])
MODEL = robot(cov=KNOWN)
GIVEN = evidence(MODEL, 4)
place, reading = pgm.Variable("place"), pgm.Variable("reading")


def line(cov=1.0, noise=0.04, mean=0.0, sensor=0.2):
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, mean, cov)],
        [pgm.LinearGaussianCPD(place, {place.previous: 1.0}, cov=noise)],
        [pgm.LinearGaussianCPD(reading, {place: 1.0}, cov=sensor)],
    )


def test_online_is_the_filter():
    due = pgm.filter(MODEL, GIVEN, belief=grid())
    robot_ = pgm.OnlineFilter(MODEL, belief=grid())
    belief, read = robot_.initial(), GIVEN[z]
    for step in range(5):
        if step:
            belief = robot_.predict(belief, {u: GIVEN[u][step - 1]})
            assert belief.kind.name == "predicted"
        rows = np.flatnonzero(np.asarray(read.step) == step)
        seen = pgm.sightings(read.values[rows], given={m: read.given[m][rows]})
        belief = robot_.update(belief, {z: seen})
        assert belief.kind.name == "filtered"
        assert_allclose(belief[x].values, due[x.at(step)].values, rtol=1e-9, atol=1e-15)
    assert_allclose(belief.log_evidence, due.log_evidence, rtol=1e-12)
    assert_allclose(belief.status.outside, due.status.outside, atol=1e-12)
    robot_, belief = pickle.loads(pickle.dumps((robot_, belief)))
    assert robot_.predict(belief, {u: [0.1, 0.0]}).step == 5


def test_online_runs_at_once():
    robot_ = pgm.OnlineFilter(line(), belief=pgm.Grid({"place": (-6, 6, 60)}))
    belief = robot_.update(robot_.initial(), {reading: [[0.1], [-0.4]]})
    belief = robot_.predict(belief)
    assert belief.log_evidence.shape == (2,) == belief[place].lead
    for run, value in enumerate((0.1, -0.4)):
        alone = robot_.predict(robot_.update(robot_.initial(), {reading: value}))
        assert_allclose(alone[place].mean, belief[place].mean[run])


def test_a_belief_and_its_moments():
    found = pgm.smooth(MODEL, GIVEN, belief=grid())
    belief = found[x.at(2)]
    assert belief.components == x.components
    assert belief.values.shape == (50, 40, 36)
    points = np.stack(np.meshgrid(*belief.centres, indexing="ij"), axis=-1).reshape(-1, 3)
    weight = belief.values.reshape(-1)
    mean = weight @ points  # this heading is far from ±π
    assert_allclose(belief.mean, mean, rtol=1e-10)
    cov = (weight[:, None] * (points - mean)).T @ (points - mean)
    assert_allclose(belief.cov, cov, atol=1e-12)
    assert_allclose(belief.std, np.sqrt(np.diag(cov)), rtol=1e-8)
    assert_array_equal(belief.mode, points[weight.argmax()])
    drawn = belief.sample(20_000, rng=0)
    assert_allclose(drawn.mean(axis=0), mean, atol=0.02)
    assert_allclose(np.cov(drawn.T), cov, atol=0.01)
    assert_array_equal(belief[None].sample(20_000, rng=0)[:, 0], drawn)  # of one run
    assert isinstance(belief.gaussian(), pgm.Gaussian)
    both = belief.marginal("heading", "east")
    assert_allclose(both.values, belief.values.sum(axis=1).T)
    assert_allclose(both.cov, belief.cov[np.ix_([2, 0], [2, 0])], atol=1e-12)
    every = found[x]
    assert every.lead == (5,)
    assert_array_equal(every[2].values, belief.values)
    assert_array_equal(every[1:3].steps, [1, 2])
    assert_array_equal(every.gaussian().steps, np.arange(5))
    copied = pickle.loads(pickle.dumps(belief))
    assert_array_equal(copied.mean, belief.mean)
    assert_array_equal(copy.deepcopy(found)[x].mean, every.mean)


def test_an_angle_has_moments_across_the_cut():
    """A heading about π: as one about 0, turned."""
    there, here = (robot(cov=KNOWN, prior=(4.0, 3.0, turn)) for turn in (np.pi, 0.0))
    given = {u: [[0.0, 0.05]]}
    one, other = (pgm.filter(net, given, belief=grid())[x] for net in (there, here))
    gap = one.mean[:, 2] - other.mean[:, 2]
    assert_allclose(np.cos(gap), -1.0, atol=1e-12)
    assert_allclose(one.cov, other.cov, atol=1e-12)


def test_the_mean_of_an_angle_is_wrapped():
    """Where the offset from the circular mean leads across the cut, as it does of particles."""
    h = pgm.Variable("h", angles=("h",))
    drift = pgm.LinearGaussianCPD(h, {h.previous: 1.0}, cov=0.01)
    outside = 0
    for middle in np.linspace(-3.1, 3.1, 21):
        parts = [pgm.GaussianCPD(h, middle, 0.01), pgm.GaussianCPD(h, middle + 1.9, 0.3)]
        model = pgm.DynamicBayesianNetwork([pgm.MixtureCPD(parts, weights=[0.6, 0.4])], [drift])
        found = pgm.filter(model, {}, steps=1, belief=pgm.Grid({"h": 90}))[h]
        values, centres = found.values[0], found.centres[0]
        circular = np.angle(values @ np.exp(1j * centres))
        apart = (centres - circular + np.pi) % (2.0 * np.pi) - np.pi
        due = circular + values @ apart
        outside += not -np.pi <= due < np.pi
        assert_allclose(found.mean[0, 0], (due + np.pi) % (2.0 * np.pi) - np.pi, atol=1e-12)
    assert outside


def test_what_leaves_is_counted_and_warned_of():
    on = pgm.Grid({"place": (-3.0, 3.0, 60)})
    leaving = line(cov=0.1, mean=2.4, noise=0.05)
    with pytest.warns(pgm.GridWarning, match="left the bounds"):
        found = pgm.filter(leaving, {reading: np.full((6, 1), 2.6)}, belief=on)
    assert found.status.outside.shape == ()
    assert found.status.outside_by_step.shape == (7,)
    # Against a wide grid, cut at each step.
    wide = pgm.filter(
        leaving, {reading: np.full((6, 1), 2.6)}, belief=pgm.Grid({"place": (-3.0, 9.0, 120)})
    )
    assert wide.status.outside < 1e-9
    prior = wide[place.at(0)]
    assert_allclose(
        found.status.outside_by_step[0], prior.values[prior.centres[0] > 3].sum(), rtol=1e-9
    )


def test_what_the_lattice_adds_is_told():
    """A displacement of .3 cells without noise has a variance of .21 cells² all the same."""
    moving = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.0, 0.25)],
        [pgm.LinearGaussianCPD(place, {place.previous: 1.0}, offset=0.03, cov=0.0)],
    )
    found = pgm.filter(moving, {}, steps=4, belief=pgm.Grid({"place": (-6, 6, 120)}))
    assert_allclose(found.status.added["place"], 4 * 0.21 * 0.01, rtol=1e-9)
    assert_allclose(found[place].cov[-1, 0, 0], 0.25 + 4 * 0.21 * 0.01, rtol=1e-9)
    still = line(noise=0.0)
    found = pgm.filter(still, {}, steps=3, belief=pgm.Grid({"place": (-9, 9, 60)}))
    assert_array_equal(found.status.added["place"], 0.0)


def test_a_sharp_sensor_is_told():
    on = pgm.Grid({"place": (-6, 6, 60)})
    blunt = pgm.filter(line(), {reading: [[0.1]]}, belief=on).status
    assert blunt.sharp is None
    assert_allclose(blunt.sharpest.cells, 0.2 / 0.2**0.5)
    with pytest.warns(pgm.GridWarning, match="too sharp for the cells"):
        sharp = pgm.filter(line(sensor=0.05**2), {reading: [[0.1]]}, belief=on).status
    assert sharp.sharp == reading
    assert_allclose(sharp.sharpest.cells, 0.2 / 0.05)
    assert "sharper than half a cell" in repr(sharp)


def test_a_loop_is_warned_once_of_each_fault():
    """Python's filter knows a warning by its text, which therefore has no figures of a run."""
    wide, narrow = pgm.Grid({"place": (-6, 6, 60)}), pgm.Grid({"place": (-2, 2, 40)})
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("default")
        for value in (0.1, 0.2, 0.3):
            pgm.filter(line(sensor=0.05**2), {reading: [[value]]}, belief=wide)
        for value in (0.0, 0.5, 1.0):
            pgm.filter(line(), {reading: [[value]]}, belief=narrow)
        for value in (15.0, 16.0):
            pgm.filter(
                line(sensor=0.05**2),
                {reading: [[value]]},
                belief=pgm.Grid({"place": (-20, 20, 400)}),
            )
    words = "too sharp", "left the bounds", "cut off"
    assert len(told) == len(words), [str(each.message) for each in told]
    assert all(word in str(each.message) for word, each in zip(words, told, strict=True))


def test_a_narrow_belief_is_told():
    on = pgm.Grid({"place": (-6, 6, 60)})
    readings = {reading: [[0.1], [0.2], [0.15]]}
    due = pgm.filter(line(), readings)[place].std[..., 0] / 0.2
    status = pgm.filter(line(), readings, belief=on).status
    assert_allclose(status.narrowest.cells, due.min(), rtol=1e-6)
    assert (status.narrowest.component, status.narrowest.step) == ("place", due.argmin())
    assert "known to" not in repr(status)
    sharp = pgm.filter(line(sensor=0.1**2), readings, belief=on).status
    assert "is known to 0.46 cells" in repr(sharp)
    robot_ = pgm.OnlineFilter(line(), belief=on)
    belief = robot_.update(robot_.predict(robot_.initial()), {reading: 0.1})
    assert_allclose(belief.status.narrowest.cells, due[1], rtol=1e-6)


def test_refining_until_a_figure_stays():
    given = {reading: [[0.5], [0.7]]}
    net = line(noise=0.01, cov=0.3, sensor=0.02)
    coarse = {"place": (-4.0, 4.0, 12)}
    found = pgm.filter(net, given, belief=pgm.Grid(coarse, refine="log_evidence"))
    exact = pgm.filter(net, given)
    assert_allclose(found.log_evidence, exact.log_evidence, atol=1e-3)
    assert found.status.converged
    cells = [each.cells for each in found.status.refinements]
    assert cells == [(12 * 2**k,) for k in range(len(cells))]
    assert len(cells) > 2
    assert found.status.refinements[-1].change <= 1e-3
    assert all(each.seconds > 0.0 for each in found.status.refinements)

    def spread(posterior):
        assert isinstance(posterior, pgm.results.Posterior)
        assert posterior.to_xarray()["mean"].shape == (3, 1)
        return posterior[place].std

    with pytest.warns(pgm.GridWarning, match="still changes"):
        found = pgm.filter(
            net, given, belief=pgm.Grid(coarse, refine=spread, tolerance=1e-12, doublings=1)
        )
    assert not found.status.converged
    assert found.grid.cells["place"] == (-4.0, 4.0, 24)
    for fault, match in [
        (lambda p: p[place].values, "shape"),
        (lambda p: np.nan, "NaN"),
        (len, "failed"),
    ]:
        with pytest.raises(ModelError, match=match):
            pgm.filter(net, given, belief=pgm.Grid(coarse, refine=fault))


@pytest.mark.parametrize(
    ("cells", "match"),
    [
        ({}, "maps components"),
        ([1], "maps components"),
        ({3: (0, 1, 4)}, "components of states"),
        ({"a": (1.0, 1.0, 4)}, "lo must be less"),
        ({"a": (2.0, 1.0, 4)}, "lo must be less"),
        ({"a": (0.0, np.inf, 4)}, "finite"),
        ({"a": (0.0, 1.0, 4.5)}, "whole"),
        ({"a": (0.0, 1.0, 1)}, "2 or more"),
        ({"a": (0.0, 1.0)}, "lo, hi, cells"),
        ({"a": "wide"}, "lo, hi, cells"),
        ({"a": 2}, "3 cells or more"),
        ({"a": (1e9, 1e9 + 1e-3, 10**4)}, "too narrow"),
    ],
)
def test_grids_that_are_refused(cells, match):
    with pytest.raises(ModelError, match=match):
        pgm.Grid(cells)


@pytest.mark.parametrize(
    ("how", "match"),
    [
        ({"dtype": int}, "dtype"),
        ({"refine": "evidence"}, "refine="),
        ({"tolerance": -1.0}, "tolerance"),
        ({"doublings": 0}, "doublings"),
    ],
)
def test_keywords_that_are_refused(how, match):
    with pytest.raises(ModelError, match=match):
        pgm.Grid({"a": (0, 1, 4)}, **how)


POSE = {"east": (0.0, 10.0, 50), "north": (-0.5, 7.5, 40), "heading": 36}


@pytest.mark.parametrize(
    ("cells", "match"),
    [
        ({k: v for k, v in POSE.items() if k != "north"}, "lacks 'x.north'"),
        (POSE | {"up": (0, 1, 4)}, "'up', which is no component"),
        (POSE | {"x.east": (0, 1, 4)}, "twice"),
        (POSE | {x: (0, 1, 4)}, "3 components"),
        (POSE | {u: (0, 1, 4)}, "no state"),
        (POSE | {"heading": (0.0, 1.0, 10)}, "number of cells"),
        (POSE | {"east": 10}, "no angle"),
    ],
)
def test_grids_that_do_not_fit_the_states(cells, match):
    with pytest.raises(ModelError, match=match):
        pgm.filter(MODEL, GIVEN, belief=pgm.Grid(cells))


def test_an_ambiguous_name_is_refused():
    a, b = (pgm.Variable(name, components=("east", name)) for name in "ab")
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(v, [0, 0], np.eye(2)) for v in (a, b)],
        [pgm.LinearGaussianCPD(v, {v.previous: 1.0}, cov=np.eye(2)) for v in (a, b)],
    )
    cells = {"a": (-9, 9, 6), "b": (-9, 9, 6), "b.east": (-9, 9, 6)}
    with pytest.raises(ModelError, match=r"'a.east', 'b.east'"):
        pgm.filter(net, {}, steps=1, belief=pgm.Grid(cells | {"east": (-9, 9, 6)}))
    with pytest.warns(pgm.GridWarning):
        found = pgm.filter(net, {}, steps=9, belief=pgm.Grid(cells | {"a.east": (-9, 9, 6)}))
    assert found[a].components == ("a.east", "a")


def test_what_a_grid_takes_not():
    on = grid()
    for keyword, value in [
        ("lineariser", pgm.Unscented()),
        ("keep", x),
        ("iterations", 3),
        ("start", {x: np.zeros((5, 3))}),
        ("damping", 0.5),
    ]:
        call = pgm.smooth if keyword == "start" else pgm.filter
        with pytest.raises(ModelError, match="grid"):
            call(MODEL, GIVEN, belief=on, **{keyword: value})
    with pytest.raises(ModelError, match=r"pgm.Grid\(\.\.\.\)"):
        pgm.filter(MODEL, GIVEN, belief=POSE)
    with pytest.raises(GraphError, match="along a chain of slices"):
        pgm.smooth(MODEL, GIVEN, belief=on, method=pgm.Balanced())
    graph = pgm.compile(pgm.BayesianNetwork([pgm.GaussianCPD(place, 0.0, 1.0)]))
    with pytest.raises(GraphError, match="dynamic networks"):
        pgm.infer(graph, {}, belief=on)
    state = pgm.Discrete("state", 2)
    tables = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(state, table=[0.5, 0.5])],
        [pgm.TableCPD(state, state.previous, table=[[0.5, 0.5], [0.1, 0.9]])],
    )
    with pytest.raises(ModelError, match="network of tables"):
        pgm.filter(tables, {}, steps=1, belief=on)
    for fault in ({"lag": 2}, {"lineariser": pgm.Unscented()}):
        with pytest.raises(ModelError, match="grid"):
            pgm.OnlineFilter(MODEL, belief=on, **fault)
    with pytest.raises(ModelError, match="refine"):
        pgm.OnlineFilter(MODEL, belief=pgm.Grid(POSE, refine="log_evidence"))


def test_memory_is_refused_before_it_is_taken():
    huge = pgm.Grid({"east": (0.0, 10.0, 5000), "north": (-0.5, 7.5, 4000), "heading": 720})
    with pytest.raises(ModelError, match=r"720 × 5000 × 4000 = 14,400,000,000 cells.*GiB"):
        pgm.filter(MODEL, GIVEN, belief=huge)
    with pytest.raises(ModelError, match="GiB"):
        pgm.OnlineFilter(MODEL, belief=huge)


def test_impossible_evidence_names_sensor_and_step():
    on = pgm.Grid({"place": (-6, 6, 60)})
    two = pgm.sightings([[0.0], [50.0], [-50.0]], step=[0, 1, 1])
    found = pgm.filter(line(sensor=0.01), {reading: two}, steps=1, belief=on)
    assert np.isfinite(found.log_evidence)
    twin = pgm.Variable("twin")
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.0, 1.0), pgm.LinearGaussianCPD(twin, {place: 1.0}, cov=0.0)],
        [pgm.LinearGaussianCPD(v, {v.previous: 1.0}, cov=0.0) for v in (place, twin)],
        [pgm.LinearGaussianCPD(reading, {place: 1.0, twin: -1.0}, cov=1e-6)],
    )
    seen = pgm.sightings([[0.0], [3.0]], step=[0, 2])
    both = pgm.Grid({"place": (-6, 6, 60), "twin": (-6, 6, 60)})
    with pytest.raises(
        EvidenceError, match=r"measurements of reading at step 2, .* impossible"
    ) as told:
        pgm.filter(net, {reading: seen}, steps=3, belief=both)
    assert (told.value.variable, told.value.step) == (reading, 2)
    walled = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, 0.0, 0.0)],
        [pgm.LinearGaussianCPD(place, {place.previous: 1.0}, offset=0.3, cov=0.0)],
    )
    with pytest.raises(NumericalError, match="left the grid at step 31"):
        pgm.filter(walled, {}, steps=40, belief=on)


def test_a_prior_outside_the_bounds():
    with pytest.raises(ModelError, match=r"prior has .* inside the grid"):
        pgm.filter(line(mean=9.0), {}, steps=1, belief=pgm.Grid({"place": (-6, 6, 60)}))


def test_sensors_that_no_grid_takes():
    def exact(noise):
        (sensor,) = MODEL.observation
        return MODEL.replace(
            observation=[pgm.NonlinearGaussianCPD(z, (x, m), sensor.function, noise)]
        )

    with pytest.raises(ModelError, match="no noise"):
        pgm.filter(exact(np.diag([0.1, 0.0])), GIVEN, belief=grid())

    def holes(x, m):
        return np.where(x[..., :1] > 2.0, sight(x, m), np.nan)

    (sensor,) = MODEL.observation
    net = MODEL.replace(observation=[pgm.NonlinearGaussianCPD(z, (x, m), holes, sensor.cov)])
    with pytest.raises(LinearisationError, match=r"NaN or infinite at .* centres"):
        pgm.filter(net, GIVEN, belief=grid())
    v, gauge = pgm.Variable("v"), pgm.Variable("gauge")
    net = line().replace(
        transition=[
            pgm.GaussianCPD(v, 0.0, 1.0),
            pgm.LinearGaussianCPD(place, {place.previous: 1.0, v: 1.0}, cov=0.1),
        ],
        observation=[pgm.LinearGaussianCPD(gauge, {v: 1.0}, cov=1.0)],
    )
    with pytest.raises(ModelError, match="hidden control"):
        pgm.filter(net, {gauge: [[0.1]]}, belief=pgm.Grid({"place": (-6, 6, 60)}))


def test_an_order_that_no_grid_has():
    a, b = pgm.Variable("a"), pgm.Variable("b")
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(a, 0.0, 1.0), pgm.GaussianCPD(b, 0.0, 1.0)],
        [
            pgm.LinearGaussianCPD(a, {a.previous: 1.0}, cov=0.1),
            pgm.LinearGaussianCPD(b, {b.previous: 1.0, a: 1.0, a.previous: -1.0}, cov=0.1),
        ],
    )
    with pytest.raises(ModelError, match="no order of their axes"):
        pgm.filter(net, {}, steps=1, belief=pgm.Grid({"a": (-6, 6, 30), "b": (-6, 6, 30)}))


def test_noise_over_too_many_cells():
    (motion,) = MODEL.transition
    noise = 900.0 * np.array([[1.0, 0.5, 0.2], [0.5, 1.0, 0.7], [0.2, 0.7, 1.0]])
    net = MODEL.replace(
        transition=[pgm.NonlinearGaussianCPD(x, (x.previous, u), motion.function, noise)]
    )
    with pytest.raises(ModelError, match="displacements of the grid would be summed"):
        pgm.filter(net, GIVEN, belief=grid())


def test_results_name_what_is_not_there():
    found = pgm.filter(MODEL, GIVEN, belief=grid())
    with pytest.raises(EvidenceError, match="no state that the grid covers"):
        found.joint(z)
    with pytest.raises(EvidenceError, match="by variable"):
        found["x"]
    with pytest.raises(ModelError, match="after the last step"):
        found[x.at(9)]
    with pytest.raises(ModelError, match="no component"):
        found[x].marginal("up")
    with pytest.raises(ModelError, match="each once"):
        found[x].marginal("east", "east")
    with pytest.raises(ModelError, match="whole variables"):
        found[x].marginal("east").gaussian()
    with pytest.raises(ModelError, match="leading axes"):
        found[x][7]
    with pytest.raises(AttributeError, match="immutable"):
        found[x].values = 3
    assert found.log_evidence_kind == "grid"
    assert "72,000 cells" in repr(found)
