"""Grids of robots: against particles, transposes, and the ways in which a motion is moved."""

import numpy as np
import pytest
from grid.sighted import drive, evidence, grid, m, robot, sight, u, x, z
from numpy.testing import assert_allclose

import pgm
from pgm.beliefs.grid.lattice import resolve
from pgm.beliefs.grid.moves import Split, Sweep
from pgm.beliefs.grid.slices import GridModel, GridSlices
from pgm.beliefs.markov.chain import StateChain
from pgm.schedules.binding import bind_chain

KNOWN = np.diag([0.1, 0.1, 0.05])


def slices(model, given, on):
    lattice = resolve(on, model.states)
    return GridSlices(GridModel(lattice, model, bind_chain(model, given, None)), 0)


def bootstrap(model, given, count, seed=0):
    """A textbook particle filter: the particles and weights of each step before resampling."""
    rng = np.random.default_rng(seed)
    prior, (motion,), (sensor,) = model.prior[0], model.transition, model.observation
    particles = rng.multivariate_normal(prior.mean, prior.cov, count)
    controls, read = np.asarray(given[u]), given[z]
    steps, seen = np.asarray(read.step), np.asarray(read.given[m])
    values, log_evidence = np.asarray(read.values), 0.0
    for step in range(len(controls) + 1):
        if step:
            particles = drive(particles, np.tile(controls[step - 1], (count, 1)))
            particles = particles + rng.standard_normal((count, 3)) * np.sqrt(np.diag(motion.cov))
        log_weight = np.zeros(count)
        for row in np.flatnonzero(steps == step):
            gap = values[row] - sight(particles, seen[row])
            gap[:, 1] = (gap[:, 1] + np.pi) % (2 * np.pi) - np.pi
            log_weight -= 0.5 * (gap**2 / np.diag(sensor.cov)).sum(axis=1)
            log_weight -= 0.5 * np.log(np.linalg.det(2 * np.pi * sensor.cov))
        top = log_weight.max()
        weight = np.exp(log_weight - top)
        log_evidence += top + np.log(weight.mean())
        weight /= weight.sum()
        yield particles, weight, log_evidence
        level = (rng.random() + np.arange(count)) / count
        particles = particles[np.searchsorted(np.cumsum(weight), level).clip(max=count - 1)]


def moments(particles, weight):
    about = np.arctan2(weight @ np.sin(particles[:, 2]), weight @ np.cos(particles[:, 2]))
    particles = particles.copy()
    particles[:, 2] = about + (particles[:, 2] - about + np.pi) % (2 * np.pi) - np.pi
    mean = weight @ particles
    return mean, np.cov(particles.T, aweights=weight, ddof=0)


def divergence(mean, cov, other, spread):
    """KL of N(mean, cov) to N(other, spread), the heading's difference wrapped."""
    gap = other - mean
    gap[2] = (gap[2] + np.pi) % (2 * np.pi) - np.pi
    inverse = np.linalg.inv(spread)
    ratio = np.linalg.slogdet(spread)[1] - np.linalg.slogdet(cov)[1]
    return 0.5 * (np.trace(inverse @ cov) - 3 + ratio + gap @ inverse @ gap)


def compared(model, given, on, count):
    """The KL of each step, of particles' moments to the grid's, and both log-evidences."""
    found = pgm.filter(model, given, belief=on)
    beliefs, each, due = found[x], [], 0.0
    for step, (particles, weight, so_far) in enumerate(bootstrap(model, given, count)):
        here, due = beliefs[step], so_far
        each.append(divergence(*moments(particles, weight), here.mean, here.cov))
    return np.array(each), found.log_evidence, due


def test_a_robot_against_particles():
    model = robot(0.1, 0.06, cov=KNOWN)
    kl, found, due = compared(model, evidence(model, 6), grid(fine=2), 40_000)
    assert kl.max() <= 0.01
    assert abs(found - due) <= 0.06


@pytest.mark.slow
@pytest.mark.parametrize(
    ("width", "turn", "plane", "heading", "due"),
    [(0.15, 72, 0.1, 0.06, 6e-3), (0.075, 144, 0.05, 0.03, 5e-4)],
)
def test_a_robot_against_a_million_particles(width, turn, plane, heading, due):
    model = robot(plane, heading, cov=KNOWN)
    cells = {
        "east": (0.0, 10.05, round(10.05 / width)),
        "north": (0.0, 7.5, round(7.5 / width)),
        "heading": turn,
    }
    given = evidence(model, 12)
    kl, found, log_evidence = compared(model, given, pgm.Grid(cells), 1_000_000)
    assert kl.max() <= due
    assert abs(found - log_evidence) <= 0.02


def inner(model, given, on, steps=3):
    """⟨A p, b⟩ and ⟨p, Aᵀ b⟩ of each step."""
    chain, rng = slices(model, given, on), np.random.default_rng(0)
    belief = chain.prior()
    for step in range(1, steps + 1):
        after = chain.forward(step, belief)
        message = rng.random(after.shape)
        source, target = chain.windows[step]
        lattice = chain.lattice
        inside = lattice.put(lattice.cut(belief, source), source)
        there = lattice.put(lattice.cut(message, target), target)
        yield (after * there).sum(), (inside * chain.backward(step, message)).sum()
        belief = after / after.sum()


def veer(x, u):
    """A motion that depends on where the robot is: either way on the other."""
    moved = drive(x, u)
    moved[..., 0] += 0.2 * np.sin(x[..., 1])
    moved[..., 1] += 0.1 * np.cos(0.5 * x[..., 0])
    return moved


def replaced(model, cpd):
    return model.replace(transition=cpd if isinstance(cpd, list) else [cpd])


def motions():
    model = robot(cov=KNOWN)
    noise = np.diag([0.02, 0.02, 0.01])
    mixed = noise + 0.004 * (np.ones((3, 3)) - np.eye(3)) * [[1, 1, 0], [1, 1, 0], [0, 0, 1]]
    v = pgm.Variable("v", components=("distance", "turn"))
    through = [
        pgm.LinearGaussianCPD(v, {u: 1.0}, cov=np.diag([0.02, 0.003])),
        pgm.NonlinearGaussianCPD(x, (x.previous, v), drive, np.diag([0.005, 0.005, 0.002])),
    ]
    cases = {
        "by heading": model,
        "correlated": replaced(model, pgm.NonlinearGaussianCPD(x, (x.previous, u), drive, mixed)),
        "by place": replaced(model, pgm.NonlinearGaussianCPD(x, (x.previous, u), veer, noise)),
        "narrow": replaced(model, pgm.NonlinearGaussianCPD(x, (x.previous, u), veer, noise * 0.1)),
        "controls": replaced(model, through),
    }
    return [pytest.param(net, id=name) for name, net in cases.items()]


@pytest.mark.parametrize("net", motions())
def test_the_smoother_uses_transposes(net):
    for one, other in inner(net, evidence(robot(), 3), grid()):
        assert_allclose(one, other, rtol=1e-12)


@pytest.mark.parametrize("net", motions())
def test_a_step_has_the_mean_and_variance_of_the_model(net):
    """Against draws of the CPDs: the moments of one step from a narrow prior, but for Jensen's."""
    given = {u: evidence(robot(), 1)[u]}
    prior = [pgm.GaussianCPD(x, [4.0, 3.0, 0.5], np.diag([0.02, 0.02, 0.03]))]
    net = net.replace(prior=prior)
    found = pgm.filter(net, given, belief=grid(fine=2))
    belief = found[x.at(1)]
    drawn = net.sample(given, runs=200_000, rng=0)[x][:, 1]
    scale = drawn.std(axis=0)
    added = np.array([found.status.added[name] for name in belief.components])
    assert_allclose(belief.mean, drawn.mean(axis=0), atol=0.01 * scale.max())
    far = 0.02 * np.multiply.outer(scale, scale).max()
    assert_allclose(belief.cov - np.diag(added), np.cov(drawn.T), atol=far)


def kinds(net):
    chain = slices(net, evidence(robot(), 2), grid())
    belief = chain.prior()
    made = chain.model.motion.at(1, 0, chain.windows[0][0])
    assert belief.sum() == pytest.approx(1.0)
    return made.operators


def test_a_motion_by_heading_is_moved_along_axes():
    (sweep,) = kinds(robot(cov=KNOWN))
    assert isinstance(sweep, Sweep)
    assert [(move.axis, move.by) for move in sweep.moves] == [(1, (0,)), (2, (0,)), (0, ())]


def test_a_motion_by_place_is_split():
    split, blur = kinds(motions()[2].values[0])
    assert isinstance(split, Split)
    assert [move.by for move in blur.moves] == [()] * len(blur.moves)


def test_a_dependence_on_one_corner_is_found():
    """A patch of cells that no probe is likely to meet."""

    def trap(x, u):
        moved = drive(x, u)
        moved[..., 0] += np.where((x[..., 0] < 0.2) & (x[..., 1] < 0.0), 0.5, 0.0)
        return moved

    cpd = pgm.NonlinearGaussianCPD(x, (x.previous, u), trap, np.diag([0.01, 0.01, 0.004]))
    (sweep,) = kinds(replaced(robot(cov=KNOWN), cpd))
    east = next(move for move in sweep.moves if move.axis == 1)
    assert east.by == (0, 2)
    assert east.first.shape[-1] > 1  # by its own place too


def test_a_sensor_with_a_patch_is_not_taken_for_a_sum():
    def patched(x, m):
        found = sight(x, m)
        near = (x[..., 0] < 0.4) & (x[..., 1] < 0.2)
        found[..., 1] += np.where(near & (np.abs(x[..., 2]) < 0.2), 0.3, 0.0)
        return found

    model = robot(cov=KNOWN)
    given = evidence(model, 2)
    weights = {}
    for name, function in (("plain", sight), ("patched", patched)):
        (sensor,) = model.observation
        net = model.replace(observation=[pgm.NonlinearGaussianCPD(z, (x, m), function, sensor.cov)])
        chain = slices(net, given, grid())
        chain.prior()
        chain.windows[0] = (chain.lattice.whole,) * 2
        found, scale = chain.likelihood(0)
        weights[name] = np.log(np.maximum(found, 1e-300)) + scale
        points = np.stack(
            np.meshgrid(*(axis.centres for axis in chain.lattice.axes), indexing="ij"), axis=-1
        )[..., [1, 2, 0]]
        read = given[z]
        due = sum(
            net.observation[0].log_density(read.values[k], {x: points, m: read.given[m][k]})
            for k in np.flatnonzero(np.asarray(read.step) == 0)
        )
        open_ = due > due.max() - 500
        assert_allclose(weights[name][open_], due[open_], rtol=1e-9, atol=1e-9)


def test_what_is_found_out_later_changes_nothing():
    """A robot that stands still at first: that it depends on its heading shows after two steps."""
    model = robot(cov=KNOWN)
    controls = np.array([[0.0, 0.0], [0.0, 0.1], [0.3, 0.2], [0.25, 0.0]])
    given = evidence(model, 4, controls=controls)
    found = pgm.smooth(model, given, belief=grid())
    backwards = slices(model, {u: controls[::-1]}, grid())
    belief = backwards.prior()
    for step in range(1, 5):  # what it depends on is known from the first step on
        belief = backwards.forward(step, belief)
    chain = slices(model, given, grid())
    chain.model.motion.known.update(backwards.model.motion.known)
    due = StateChain(chain).run()
    for step, belief in due.smoothed():
        assert_allclose(found[x.at(step)].values.transpose(2, 0, 1), belief, rtol=1e-6, atol=1e-12)


def test_a_world_turned_round_is_the_same():
    """Headings about ±π, where windows of active cells go past the end of the circle."""
    model = robot(cov=KNOWN)
    given = evidence(model, 6)
    read = given[z]
    turned = robot(cov=KNOWN, prior=(-4.0, -3.0, 0.5 + np.pi))
    about = {
        u: given[u],
        z: pgm.sightings(read.values, step=read.step, given={m: -np.asarray(read.given[m])}),
    }
    there = pgm.Grid({"east": (-10.0, 0.0, 50), "north": (-7.5, 0.5, 40), "heading": 36})
    one, other = pgm.smooth(model, given, belief=grid()), pgm.smooth(turned, about, belief=there)
    assert_allclose(one.log_evidence, other.log_evidence, rtol=1e-10)
    mirrored = np.roll(other[x].values[:, ::-1, ::-1], 18, axis=-1)
    assert_allclose(one[x].values, mirrored, atol=1e-12)


def test_map_coordinates_cost_no_digits():
    near, far = (0.0, 0.0), (2.0**20, -(2.0**21))
    model, moved = (robot(cov=KNOWN, prior=(4.0 + s[0], 3.0 + s[1], 0.5)) for s in (near, far))
    given = evidence(model, 5)
    read = given[z]
    shifted = {
        u: given[u],
        z: pgm.sightings(read.values, step=read.step, given={m: read.given[m] + np.array(far)}),
    }
    one = pgm.smooth(model, given, belief=grid())
    other = pgm.smooth(moved, shifted, belief=grid(far))
    assert_allclose(one.log_evidence, other.log_evidence, atol=1e-7)
    assert_allclose(one[x].mean + np.array([*far, 0.0]), other[x].mean, atol=1e-8)
    assert_allclose(one[x].cov, other[x].cov, atol=1e-8)


def test_a_patch_that_comes_with_the_inputs_is_found():
    """A puddle, whose place is an input, stops what is in it: .2 % of the cells, from step 3 on."""
    place = pgm.Variable("place", components=("east", "north"))
    puddle = pgm.Variable("puddle", components=("east", "north", "ahead"))

    def gone(place, puddle):
        apart = np.hypot(*np.moveaxis(place - puddle[..., :2], -1, 0))
        ahead = np.where(apart < 0.5, 0.0, puddle[..., 2])
        return place + np.stack([ahead, 0.0 * ahead], axis=-1)

    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, [0.0, 0.0], 0.02 * np.eye(2))],
        [pgm.NonlinearGaussianCPD(place, (place.previous, puddle), gone, 0.02 * np.eye(2))],
    )
    given = np.array([[50.0, 50.0, 1.0], [50.0, 50.0, 1.0], [2.1, 0.05, 1.0]])
    on = pgm.Grid({"east": (-10, 10, 200), "north": (-10, 10, 200)})
    found = pgm.filter(net, {puddle: given}, belief=on)[place]
    drawn = np.random.default_rng(0).normal([2.0, 0.0], 0.06**0.5, (400_000, 2))
    due = gone(drawn, np.broadcast_to(given[2], (len(drawn), 3)))
    assert_allclose(found.mean[-1], due.mean(axis=0), atol=0.02)
    assert_allclose(found.std[-1], np.sqrt(due.var(axis=0) + 0.02), atol=0.02)


def test_a_sensor_disturbed_at_a_place_that_comes_with_the_inputs():
    """A compass that a magnet turns by one: near it, 1 cell in 1000 of the plane."""
    compass, magnet = (pgm.Variable(n, components=("a", "b")[:k]) for n, k in (("c", 1), ("g", 2)))

    def read(x, magnet):
        near = np.hypot(x[..., 0] - magnet[..., 0], x[..., 1] - magnet[..., 1]) < 0.12
        return x[..., 2:] + np.where(near, 1.0, 0.0)[..., None]

    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, [4.1, 3.0, 0.0], np.diag([0.02, 0.02, 0.1]))],
        [pgm.LinearGaussianCPD(x, {x.previous: np.eye(3)}, cov=0.01 * np.eye(3))],
        [pgm.NonlinearGaussianCPD(compass, (x, magnet), read, 0.1)],
    )
    robot_ = pgm.OnlineFilter(net, belief=grid())
    belief = robot_.initial()
    for at in ([50.0, 50.0], [4.1, 3.0]):
        before, belief = (
            belief,
            robot_.update(belief, {compass: pgm.sightings([[0.5]], given={magnet: [at]})}),
        )
    points = np.stack(np.meshgrid(*belief[x].centres, indexing="ij"), axis=-1)
    apart = 0.5 - read(points, np.array([4.1, 3.0]))[..., 0]
    due = before[x].values * np.exp(-5.0 * apart**2)
    assert_allclose(belief[x].values, due / due.sum(), atol=1e-12)
