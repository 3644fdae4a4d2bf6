"""Grids of CPDs given by their density, against sums over a line, and Gaussian ones."""

import numpy as np
from numpy.testing import assert_allclose
from scipy.stats import laplace, norm, t, vonmises

import pgm

x, z, u = pgm.variables("x z u")
READ = np.array([[1.4], [1.9], [-0.5], [2.2], [1.0]])
PUSHED = np.array([[0.2], [0.5], [-0.8], [0.4], [0.1]])
SCALE = 0.4


def start(y):
    return norm.logpdf(y[..., 0], 0.3, 0.8)


def log_move(y, before, u):
    return laplace.logpdf((y - 0.9 * before - u)[..., 0], scale=SCALE)


def draw_move(before, u, size, rng):
    return 0.9 * before + u + rng.laplace(scale=SCALE, size=(*size, 1))


def log_read(c, y):
    return t.logpdf((c - y)[..., 0], df=3, scale=0.5)


def model(**other):
    parts = {
        "prior": [pgm.SampledCPD(x, log_density=start)],
        "transition": [pgm.SampledCPD(x, (x.previous, u), sample=draw_move, log_density=log_move)],
        "observation": [pgm.SampledCPD(z, x, log_density=log_read)],
    } | other
    return pgm.DynamicBayesianNetwork(**parts)


GIVEN = {u: PUSHED, z: READ}


def line(cells, reach=10.0):
    return pgm.Grid({"x": (-reach, reach, cells)})


def twin(cells, pushed=PUSHED, read=READ):
    """Filtered and smoothed beliefs, and the log-evidence."""
    width = 20.0 / cells
    c = (np.arange(cells) + 0.5) * width - 10.0
    moves = [np.exp(laplace.logpdf(c[:, None], 0.9 * c + push, SCALE)) for push in pushed]
    belief, log_evidence = norm.pdf(c, 0.3, 0.8) * width, 0.0
    filtered = [belief]
    for move, value in zip(moves, read, strict=True):
        belief = (move / move.sum(axis=0)) @ belief * t.pdf(value - c, df=3, scale=0.5)
        log_evidence += np.log(belief.sum())
        belief = belief / belief.sum()
        filtered.append(belief)
    after, smoothed = np.ones(cells), [belief]
    for k in range(len(read) - 1, -1, -1):
        after = (moves[k] / moves[k].sum(axis=0)).T @ (t.pdf(read[k] - c, df=3, scale=0.5) * after)
        both = filtered[k] * after
        smoothed.append(both / both.sum())
    return np.array(filtered), np.array(smoothed[::-1]), log_evidence


def test_a_twin_of_ten_lines_and_convergence():
    exact = twin(1200)[2]
    for cells in (100, 200, 300):
        filtered, smoothed, log_evidence = twin(cells)
        found = pgm.smooth(model(), GIVEN, belief=line(cells))
        assert_allclose(found.filtered[x].values, filtered, atol=1e-8)
        assert_allclose(found[x].values, smoothed, atol=1e-8)
        assert_allclose(found.log_evidence, log_evidence, atol=1e-8)
        width = 20.0 / cells
        assert abs(found.log_evidence - exact) < 0.3 * width**2
        # Laplace's density has a kink: the sum over centres tells of it.
        assert_allclose(found.status.uneven.share, width**2 / (8.0 * SCALE**2), rtol=0.05)
        assert found.status.uneven.variable == x
        assert found.status.outside < 1e-8


def test_particles_agree():
    found = pgm.filter(model(), GIVEN, belief=line(400))
    cloud = pgm.filter(
        model(prior=[pgm.GaussianCPD(x, 0.3, 0.64)]), GIVEN, belief=pgm.Particles(100_000, seed=4)
    )
    assert np.abs(found[x].mean - cloud[x].mean).max() < 0.02
    assert np.abs(found[x].std - cloud[x].std).max() < 0.02
    assert abs(found.log_evidence - cloud.log_evidence) < 0.02


def gaussian():
    return pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(x, 0.3, 0.64)],
        [pgm.LinearGaussianCPD(x, {x.previous: 0.9, u: 1.0}, cov=0.16)],
        [pgm.LinearGaussianCPD(z, {x: 1.0}, cov=0.25)],
    )


def by_density():
    return model(
        transition=[
            pgm.SampledCPD(
                x,
                (x.previous, u),
                log_density=lambda y, b, u: norm.logpdf((y - 0.9 * b - u)[..., 0], scale=0.4),
            )
        ],
        observation=[
            pgm.SampledCPD(z, x, log_density=lambda c, y: norm.logpdf((c - y)[..., 0], scale=0.5))
        ],
    )


def test_a_normal_density_is_the_gaussian_cpd():
    due = pgm.smooth(gaussian(), GIVEN)
    twice = gaussian()
    mixed = twice.replace(
        prior=[pgm.MixtureCPD(twice.prior * 2, [0.4, 0.6])],
        transition=[pgm.MixtureCPD(twice.transition * 2, [0.4, 0.6])],
        observation=[pgm.MixtureCPD(twice.observation * 2, [0.4, 0.6])],
    )
    plain = pgm.smooth(twice, GIVEN, belief=line(40))
    for net in (by_density(), mixed):
        found = pgm.smooth(net, GIVEN, belief=line(100))
        assert_allclose(found[x].mean, due[x].mean, atol=1e-10)
        assert_allclose(found[x].std, due[x].std, atol=1e-10)
        assert_allclose(found.log_evidence, due.log_evidence, atol=1e-10)
        assert_allclose(found.status.sharpest.cells, 0.4)
        # On cells that are too wide the two differ, and both say so.
        found = pgm.smooth(net, GIVEN, belief=line(40))
        assert abs(found.log_evidence - plain.log_evidence) < 5e-3
        assert found.status.narrowest.cells < 0.75
    assert_allclose(found[x].values, plain[x].values, atol=1e-13)  # mixed, moved alike


def test_online_and_batches():
    grid = line(200)
    due = pgm.filter(model(), GIVEN, belief=grid)
    robot = pgm.OnlineFilter(model(), belief=grid)
    belief = robot.initial()
    for k in range(5):
        belief = robot.update(robot.predict(belief, {u: PUSHED[k]}), {z: READ[k]})
    assert_allclose(belief[x].values, due[x].values[-1], atol=1e-14)
    assert_allclose(belief.log_evidence, due.log_evidence, rtol=1e-12)
    assert belief.status.uneven.share == due.status.uneven.share
    both = {u: np.stack([PUSHED, -PUSHED]), z: np.stack([READ, READ + 0.3])}
    batch = pgm.filter(model(), both, belief=grid)
    alone = pgm.filter(model(), {u: -PUSHED, z: READ + 0.3}, belief=grid)
    assert_allclose(batch[x].values[0], due[x].values, atol=1e-14)
    assert_allclose(batch[x].values[1], alone[x].values, atol=1e-14)
    still = model(
        transition=[pgm.SampledCPD(x, x.previous, log_density=lambda y, b: log_move(y, b, 0.1))]
    )
    calls = pgm.filter(still, {z: READ}, belief=grid)  # weights that are kept, cut to windows
    assert_allclose(calls[x].values, twin(200, np.full((5, 1), 0.1))[0], atol=1e-8)


place = pgm.Variable("place", components=("along", "turn"), angles=("turn",))
sign = pgm.Variable("sign", components=("along", "turn"), angles=("turn",))


def wrapped(angle):
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def drive(before):
    along, turn = before[..., 0], before[..., 1]
    return np.stack([along + 0.5 * np.cos(turn), turn + 0.4], axis=-1)


def test_a_robot_that_slips_or_is_carried_away():
    """A mixture of Gaussian moves and a flat density, on a line and a circle."""
    cov = np.diag([0.25**2, 0.3**2])
    box = -np.log(8.0 * 2.0 * np.pi)
    parts = [
        pgm.NonlinearGaussianCPD(place, place.previous, drive, cov),
        pgm.LinearGaussianCPD(place, {place.previous: np.eye(2)}, cov=cov),
        pgm.SampledCPD(
            place, log_density=lambda y: np.where(np.abs(y[..., 0]) < 4.0, box, -np.inf)
        ),
    ]
    seen = pgm.LinearGaussianCPD(sign, {place: np.eye(2)}, cov=0.09 * np.eye(2))
    lost = pgm.SampledCPD(sign, log_density=lambda c: np.full(c.shape[:-1], -4.0))
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(place, [0.0, 3.0], np.diag([0.1, 0.1]))],
        [pgm.MixtureCPD(parts, [0.6, 0.3, 0.1])],
        [pgm.MixtureCPD([seen, lost], [0.9, 0.1])],
    )
    read = np.array([[-0.5, -2.9], [-0.4, -2.6], [2.0, 1.0], [2.5, 1.3]])
    grid = pgm.Grid({"along": (-6.0, 6.0, 48), "turn": 40})
    found = pgm.smooth(net, {sign: read}, belief=grid)
    # Every pair of cells at once.
    c, a = (np.arange(48) + 0.5) / 4 - 6.0, np.arange(40) * np.pi / 20 - np.pi
    cells = np.stack(np.meshgrid(c, a, indexing="ij"), axis=-1).reshape(-1, 2)
    volume = np.pi / 80

    def near(one, other, deviations):
        gap = one - other
        gap = (
            norm.pdf(gap[..., 0], scale=deviations[0]),
            norm.pdf(wrapped(gap[..., 1]), scale=deviations[1]),
        )
        return gap[0] * gap[1]

    move = 0.6 * near(cells[:, None], drive(cells), (0.25, 0.3)) * volume
    move += 0.3 * near(cells[:, None], cells, (0.25, 0.3)) * volume
    flat = np.abs(cells[:, 0]) < 4.0
    move += 0.1 * (flat / flat.sum())[:, None]
    belief = near(cells, np.array([0.0, 3.0]), (0.1**0.5, 0.1**0.5)) * volume
    beliefs, log_evidence, weights = [belief], 0.0, []
    for value in read:
        weights.append(0.9 * near(value, cells, (0.3, 0.3)) + 0.1 * np.exp(-4.0))
        belief = move @ belief * weights[-1]
        log_evidence += np.log(belief.sum())
        beliefs.append(belief := belief / belief.sum())
    after = np.ones(len(cells))
    for k in range(3, -1, -1):
        after = move.T @ (weights[k] * after)
        smoothed = beliefs[k] * after
        due = (smoothed / smoothed.sum()).reshape(48, 40)
        assert np.abs(found[place.at(k)].values - due).sum() < 1e-3
    assert abs(found.log_evidence - log_evidence) < 1e-3


def test_states_that_depend_on_one_another():
    """In order they are moved one by one, in a circle together; the prior of one has a parent."""
    p, v, q = pgm.variables("p v q")
    before, drift = p.previous, v.previous
    ahead = pgm.SampledCPD(
        p,
        (before, drift),
        log_density=lambda y, b, d: laplace.logpdf((y - b - d)[..., 0], scale=0.6),
    )
    prior = [
        pgm.GaussianCPD(v, 0.2, 0.2),
        pgm.SampledCPD(p, v, log_density=lambda y, v: norm.logpdf((y - v)[..., 0], scale=0.5)),
    ]
    read = pgm.LinearGaussianCPD(q, {p: 1.0}, cov=0.3)
    n, m = 48, 24
    a, b = (np.arange(n) + 0.5) / 4 - 6.0, (np.arange(m) + 0.5) / 4 - 3.0
    belief = norm.pdf(b, 0.2, 0.2**0.5) * norm.pdf(a[:, None], b, 0.5) / 16.0
    grid, values = pgm.Grid({"p": (-6, 6, n), "v": (-3, 3, m)}), np.array([[0.3], [0.8], [1.5]])
    for back in (0.0, -0.2):
        given = {drift: 0.9} if back == 0.0 else {drift: 0.9, before: back}
        net = pgm.DynamicBayesianNetwork(
            prior, [ahead, pgm.LinearGaussianCPD(v, given, cov=0.16)], [read]
        )
        found = pgm.filter(net, {q: values}, belief=grid)
        one = laplace.pdf(a[:, None, None], a[:, None] + b, 0.6)
        other = norm.pdf(b[:, None, None], 0.9 * b + back * a[:, None], 0.4)
        now = belief / belief.sum()
        for value in values[:, 0]:
            now = np.einsum("apv,bpv,pv->ab", one / one.sum(axis=0), other / 4.0, now)
            now *= norm.pdf(value, a, 0.3**0.5)[:, None]
            now /= now.sum()
        assert np.abs(found[p].mean[-1, 0] - a @ now.sum(axis=1)) < 2e-3
        assert np.abs(found[v].mean[-1, 0] - now.sum(axis=0) @ b) < 2e-3


def test_parts_of_a_prior_differ_by_run_and_noise_by_input():
    pair, both = (pgm.Variable(name, components=("a", "b")) for name in ("pair", "both"))
    cov = np.array([[0.5, 0.3], [0.3, 0.6]])  # wide for the cells, and correlated
    noise = pgm.noise(lambda u: u[..., None] * np.eye(2), given=u)
    seen = pgm.LinearGaussianCPD(both, {pair: np.eye(2)}, cov=noise)
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(pair, [[0.0, 0.5], [1.0, -0.5]], cov)],
        [pgm.LinearGaussianCPD(pair, {pair.previous: np.eye(2)}, cov=0.2 * np.eye(2))],
        [seen],
    )
    given = {both: [[0.4, 0.1], [0.9, np.nan]], u: [[0.3], [0.5]]}
    due = pgm.filter(net, given)
    mixed = pgm.DynamicBayesianNetwork(
        [pgm.MixtureCPD(net.prior * 2, [0.5, 0.5])],
        [pgm.MixtureCPD(net.transition * 2, [0.5, 0.5])],
        [pgm.MixtureCPD([seen, seen], [0.5, 0.5])],
    )
    found = pgm.filter(mixed, given, belief=pgm.Grid({"a": (-6, 6, 60), "b": (-6, 6, 60)}))
    assert found[pair].mean.shape == (2, 3, 2)
    assert_allclose(found[pair].mean, due[pair].mean, atol=1e-8)
    assert_allclose(found[pair].cov, due[pair].cov, atol=1e-8)
    assert_allclose(found.log_evidence, due.log_evidence, atol=1e-8)


def test_an_angle_alone_on_its_circle():
    way, seen = pgm.Variable("way", angles=("way",)), pgm.Variable("seen", angles=("seen",))

    def about(kappa, shift=0.0):
        return lambda y, *x: vonmises.logpdf(sum(x, -y - shift)[..., 0], kappa)

    cells, read = 90, np.array([[-3.0], [-2.5], [-2.4]])
    c = np.arange(cells) * 2.0 * np.pi / cells - np.pi
    move = vonmises.pdf(c[:, None] - c + 0.3, 20.0)
    move /= move.sum(axis=0)
    for kappa in (4.0, 60.0):  # in a window of all cells, or of some about ±π
        net = pgm.DynamicBayesianNetwork(
            [pgm.SampledCPD(way, log_density=about(kappa, -3.0))],
            [pgm.SampledCPD(way, way.previous, log_density=about(20.0, 0.3))],
            [pgm.SampledCPD(seen, way, log_density=about(10.0))],
        )
        found = pgm.smooth(net, {seen: read}, belief=pgm.Grid({"way": cells}))
        belief = vonmises.pdf(c - 3.0, kappa) * 2.0 * np.pi / cells
        beliefs, log_evidence = [belief], 0.0
        for value in read:
            belief = (move @ belief) * vonmises.pdf(value - c, 10.0)
            log_evidence += np.log(belief.sum())
            belief = belief / belief.sum()
            beliefs.append(belief)
        assert_allclose(found.filtered[way].values, beliefs, atol=1e-12)
        assert_allclose(found.log_evidence, log_evidence, atol=1e-10)
        after = np.ones(cells)
        for k in (2, 1, 0):
            after = move.T @ (vonmises.pdf(read[k] - c, 10.0) * after)
            both = beliefs[k] * after
            assert_allclose(found[way.at(k)].values, both / both.sum(), atol=1e-12)
