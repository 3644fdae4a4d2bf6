"""Trajectories of mixed chains: against the network unrolled, whose mixtures are exact."""

import numpy as np
import pytest
from numpy.testing import assert_array_equal

import pgm

N = 20_000
SWING = pgm.Discrete("swing", states=("calm", "wild"))
X, Y, Z = pgm.variables("x y z")
READ = {Z: [[0.1], [np.nan], [3.0], [2.4]]}
STEPS = 4


def motion(variable, switch, first=0.9):
    return pgm.SwitchingCPD(
        variable,
        given=switch,
        cases={
            0: pgm.LinearGaussianCPD(variable, {variable.previous: first}, cov=0.05),
            1: pgm.LinearGaussianCPD(variable, {variable.previous: 1.0}, cov=2.0, offset=0.5),
        },
    )


def model(table=((0.9, 0.1), (0.3, 0.7)), observation=None, moves=None):
    given = () if np.ndim(table) == 1 else SWING.previous
    return pgm.DynamicBayesianNetwork(
        prior=[pgm.TableCPD(SWING, table=[0.6, 0.4]), pgm.GaussianCPD(X, 0.2, 1.0)],
        transition=[
            pgm.TableCPD(SWING, given=given, table=table),
            *(moves or [motion(X, SWING)]),
        ],
        observation=observation or [pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.3)],
    )


def unrolled(net, evidence=READ):
    """The posterior of the network without time, by its configurations of modes: exact."""
    values = np.asarray(evidence[Z])
    given = {Z.at(k): values[k - 1] for k in range(1, STEPS + 1)}
    return pgm.infer(pgm.compile(net.unroll(STEPS)), given)


def far(values, mean, cov):
    """The largest difference of draws' moments (N, d) from others, in standard errors."""
    values, mean, cov = np.asarray(values), np.asarray(mean), np.asarray(cov)
    away = values - mean
    products = away[:, :, None] * away[:, None, :]
    errors = [np.abs(away.mean(axis=0)) / (away.std(axis=0) / np.sqrt(len(values)))]
    spread = products.std(axis=0) / np.sqrt(len(values))
    errors.append((np.abs(products.mean(axis=0) - cov) / spread).ravel())
    return float(np.concatenate(errors).max())


def far_shares(states, sizes, due):
    """The largest difference of shares of joint states (N, k) from others, in standard errors."""
    flat = np.ravel_multi_index(tuple(np.asarray(states).T), sizes)
    found = np.bincount(flat, minlength=int(np.prod(sizes))) / len(flat)
    due = np.asarray(due).ravel()
    assert (found[due == 0.0] == 0.0).all()
    some = due > 0.0
    return float((np.abs(found - due)[some] / np.sqrt(due[some] / len(flat)) + 0.0).max())


def assert_joints(drawn, exact, modes=(SWING,)):
    """All states together, modes of three steps, and states by modes, against the exact ones."""
    scope = [X.at(k) for k in range(STEPS + 1)]
    joint = exact.joint(*scope)
    assert far(drawn[X][..., 0], joint.mean, joint.cov) < 5.5
    for mode in modes:
        some = [mode.at(k) for k in (1, 2, 4)]
        states = drawn[mode][:, [1, 2, 4]]
        due = exact.joint(*some).probabilities
        assert far_shares(states, due.shape, due) < 5.5


@pytest.mark.parametrize("table", [((0.9, 0.1), (0.3, 0.7)), (0.7, 0.3)], ids=["kept", "afresh"])
def test_paths_and_states_are_those_of_all_sequences(table):
    """As many Gaussians as sequences; modes that the next step remembers, or does not."""
    net = model(table)
    posterior = pgm.smooth(net, READ, belief=pgm.Gaussians(2 ** (STEPS + 1)))
    drawn = posterior.sample(N, rng=0)
    assert list(drawn) == list(posterior._hidden)
    assert drawn[X].shape == (N, STEPS + 1, 1)
    assert drawn[SWING].shape == (N, STEPS + 1)
    assert_joints(drawn, unrolled(net))
    # Given the modes, states of two steps are those of the network with these modes known.
    own = (drawn[SWING][:, 3] == 1) & (drawn[SWING][:, 4] == 0)
    values = np.asarray(READ[Z])
    given = {Z.at(k): values[k - 1] for k in range(1, STEPS + 1)}
    known = given | {SWING.at(3): "wild", SWING.at(4): "calm"}
    joint = pgm.infer(pgm.compile(net.unroll(STEPS)), known).joint(X.at(2), X.at(3))
    assert far(drawn[X][own, 2:4, 0], joint.mean, joint.cov) < 5.5


def test_an_impossible_mode_is_never_drawn():
    net = model(((0.8, 0.2), (1.0, 0.0)))
    posterior = pgm.smooth(net, READ, belief=pgm.Gaussians(2 ** (STEPS + 1)))
    drawn = posterior.sample(N, rng=1)
    assert_joints(drawn, unrolled(net))
    wild = drawn[SWING] == 1
    assert not (wild[:, 1:] & wild[:, :-1]).any()


def test_a_sighting_of_either_of_two():
    """Which of two places a reading is of is a mode of the sensor that nobody remembers."""
    beacon = pgm.Variable("beacon")
    which = pgm.Discrete("which", states=("left", "right"))
    sensor = pgm.LinearGaussianCPD(Z, {X: 1.0, beacon: 1.0}, cov=0.1)
    places = [[-1.5], [1.5]]
    step = np.array([1, 2, 2, 4])
    values = np.array([[1.0], [1.2], [-1.0], [0.9]])
    unknown = pgm.unknown(places, association="sum")
    given = {Z: pgm.sightings(values, step=step, given={beacon: unknown})}
    plain = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, 0.2, 1.0)],
        [pgm.LinearGaussianCPD(X, {X.previous: 0.9}, cov=0.4)],
        [sensor],
    )
    posterior = pgm.smooth(plain, given, steps=STEPS, belief=pgm.Gaussians(16))
    drawn = posterior.sample(N, rng=0)[X][..., 0]
    # The same without time: the four readings by the sixteen ways to take them.
    cpds = [pgm.GaussianCPD(X.at(0), 0.2, 1.0)]
    cpds += [pgm.LinearGaussianCPD(X.at(k), {X.at(k - 1): 0.9}, cov=0.4) for k in range(1, 5)]
    seen = {}
    for k, at in enumerate(step):
        own, z = pgm.Discrete(f"{which.name}{k}", states=which.states), pgm.Variable(f"z{k}")
        cases = {
            s: pgm.LinearGaussianCPD(z, {X.at(int(at)): 1.0}, cov=0.1, offset=places[s][0])
            for s in range(2)
        }
        cpds += [pgm.TableCPD(own, table=[0.5, 0.5]), pgm.SwitchingCPD(z, own, cases)]
        seen[z] = values[k]
    exact = pgm.infer(pgm.compile(pgm.BayesianNetwork(cpds)), seen)
    joint = exact.joint(*(X.at(k) for k in range(5)))
    assert far(drawn, joint.mean, joint.cov) < 5.5


def test_components_of_a_mixture_are_drawn_too():
    """A motion that is a mixture: its cause is a hidden variable, drawn with the states."""
    parts = [
        pgm.LinearGaussianCPD(X, {X.previous: 1.0}, cov=0.05),
        pgm.LinearGaussianCPD(X, {X.previous: 0.5}, cov=1.0, offset=1.0),
    ]
    net = pgm.DynamicBayesianNetwork(
        [pgm.GaussianCPD(X, 0.2, 1.0)],
        [pgm.MixtureCPD(parts, [0.8, 0.2])],
        [pgm.LinearGaussianCPD(Z, {X: 1.0}, cov=0.3)],
    )
    cause = pgm.Discrete("cause", 2)
    said = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(cause, table=[1.0, 0.0]), *net.prior],
        [
            pgm.TableCPD(cause, table=[0.8, 0.2]),
            pgm.SwitchingCPD(X, cause, dict(enumerate(parts))),
        ],
        net.observation,
    )
    posterior = pgm.smooth(net, READ, belief=pgm.Gaussians(16))
    drawn = posterior.sample(N, rng=3)
    assert_joints({X: drawn[X]}, unrolled(said), modes=())
    (own,) = set(drawn) - {X}
    due = unrolled(said).joint(cause.at(2), cause.at(3)).probabilities
    assert drawn[own].shape == (N, STEPS)  # there is none at step 0
    assert far_shares(drawn[own][:, 1:3], due.shape, due) < 5.5


@pytest.mark.parametrize(
    "belief", [pgm.Gaussians(), pgm.Gaussians(mix=True), pgm.Gaussians(8)], ids=str
)
def test_merged_beliefs_draw_modes_by_the_posterior_and_trajectories_that_move(belief):
    """Long chains: shares of modes are the posterior's whatever is merged; states obey motions."""
    place = pgm.Variable("place", components=("at", "speed"))
    turn = [[1.0, 1.0], [0.0, 1.0]]
    cases = {
        k: pgm.LinearGaussianCPD(place, {place.previous: turn}, cov=[[1e-12, 0.0], [0.0, q]])
        for k, q in enumerate((0.01, 1.0))
    }
    net = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(SWING, table=[0.6, 0.4]), pgm.GaussianCPD(place, [0.0, 0.0], 1.0)],
        [
            pgm.TableCPD(SWING, given=SWING.previous, table=[[0.9, 0.1], [0.3, 0.7]]),
            pgm.SwitchingCPD(place, SWING, cases),
        ],
        [pgm.LinearGaussianCPD(Z, {place: [[1.0, 0.0]]}, cov=0.5)],
    )
    evidence = net.sample(steps=30, runs=(2,), rng=4).evidence
    posterior = pgm.smooth(net, evidence, belief=belief)
    drawn = posterior.sample(N // 2, rng=0)
    assert drawn[place].shape == (N // 2, 2, 31, 2)
    for run, step in np.ndindex(2, 31):
        due = posterior[SWING].probabilities[run, step]
        assert far_shares(drawn[SWING][:, run, step, None], due.shape, due) < 5.5
    moved = drawn[place][:, :, 1:] - drawn[place][:, :, :-1] @ np.transpose(turn)
    assert np.abs(moved[..., 0]).max() < 1e-4  # deviations of 1e-6 by the model
    calm = drawn[SWING][:, :, 1:] == 0
    assert moved[..., 1][calm].std() == pytest.approx(0.1, rel=0.1)
    # Where much was merged, draws come nearer to all sequences of modes than the posterior does.
    exact = pgm.smooth(net, evidence, belief=pgm.Gaussians(32))[place]
    off, due = (
        np.sqrt(np.mean(np.square((mean - exact.mean) / exact.std)))
        for mean in (drawn[place].mean(axis=0), posterior[place].mean)
    )
    assert off < max(due, 0.02)


def test_a_heading_that_turns_and_curved_sensors():
    """Angles past the cut, cases of nonlinear functions, and each draw on the smoother's branch."""
    h = pgm.Variable("h", components=("east", "heading"), angles=("heading",))
    seen = pgm.Variable("seen", components=("way", "angle"), angles=("angle",))

    def turning(rate):
        def turned(before):
            move = np.cos(before[..., 1:])
            return np.concatenate([before[..., :1] + move, before[..., 1:] + rate], axis=-1)

        return pgm.NonlinearGaussianCPD(h, h.previous, turned, cov=[0.02, 0.01])

    net = pgm.DynamicBayesianNetwork(
        [pgm.TableCPD(SWING, table=[0.5, 0.5]), pgm.GaussianCPD(h, [0.0, 3.0], 0.02)],
        [
            pgm.TableCPD(SWING, given=SWING.previous, table=[[0.8, 0.2], [0.2, 0.8]]),
            pgm.SwitchingCPD(h, SWING, {0: turning(0.0), 1: turning(1.0)}),
        ],
        [pgm.NonlinearGaussianCPD(seen, h, lambda x: x, cov=[0.1, 0.05])],
    )
    drawn = net.sample(steps=6, rng=3)
    posterior = pgm.smooth(net, drawn.evidence, belief=pgm.Gaussians(64))
    found = posterior.sample(N, rng=0)[h]
    belief = posterior[h]
    assert (np.abs(found.mean(axis=0) - belief.mean) < 5.5 * belief.std / np.sqrt(N)).all()
    assert np.abs(found.std(axis=0) / belief.std - 1.0).max() < 0.04


def test_motions_and_sensors_without_noise():
    """Jumps that the mode decides exactly, and a sum of a state and a constant read exactly."""
    jumps = {k: pgm.LinearGaussianCPD(X, {X.previous: 1.0}, 0.0, offset=k) for k in range(2)}
    posterior = pgm.smooth(model(moves=[pgm.SwitchingCPD(X, SWING, jumps)]), READ)
    drawn = posterior.sample(2000, rng=0)
    assert np.abs(np.diff(drawn[X][..., 0]) - drawn[SWING][:, 1:]).max() < 1e-12
    plain = model()
    net = pgm.DynamicBayesianNetwork(
        [*plain.prior, pgm.GaussianCPD(Y, 1.0, 0.0)],
        [*plain.transition, pgm.LinearGaussianCPD(Y, {Y.previous: 1.0}, cov=0.0)],
        [pgm.LinearGaussianCPD(Z, {X: 1.0, Y: 1.0}, cov=0.0)],
    )
    posterior = pgm.smooth(net, READ, belief=pgm.Gaussians(32))
    drawn = posterior.sample(N, rng=0)
    assert (drawn[Y] == 1.0).all()
    assert np.abs(drawn[X][:, [1, 3, 4], 0] - [-0.9, 2.0, 1.4]).max() < 1e-12
    off = np.abs(drawn[X].mean(axis=0) - posterior[X].mean)
    assert (off <= 5.5 * posterior[X].std / np.sqrt(N) + 1e-12).all()


def test_runs_reproduced_and_blocks(monkeypatch):
    values = np.random.default_rng(0).normal(size=(2, 3, STEPS, 1))
    posterior = pgm.smooth(model(), {Z: values}, belief=pgm.Gaussians(8))
    drawn = posterior.sample((4, 250), rng=5)
    assert drawn[X].shape == (4, 250, 2, 3, STEPS + 1, 1)
    assert drawn[SWING].shape == (4, 250, 2, 3, STEPS + 1)
    again = posterior.sample((4, 250), rng=5)
    for variable in drawn:
        assert_array_equal(drawn[variable], again[variable])
    flat = drawn[X].reshape(1000, 2, 3, STEPS + 1, 1)
    belief = posterior[X]
    assert (np.abs(flat.mean(axis=0) - belief.mean) < 5.5 * belief.std / np.sqrt(1000)).all()
    monkeypatch.setattr("pgm.beliefs.hypotheses.draws._AT_A_TIME", 1)
    one = posterior.sample(40, rng=5)[X]
    assert one.shape == (40, 2, 3, STEPS + 1, 1)
    assert (np.abs(one.mean(axis=0) - belief.mean) < 5.5 * belief.std / np.sqrt(40)).all()
    assert posterior.sample(rng=0)[X].shape == (2, 3, STEPS + 1, 1)


def test_what_has_no_draws():
    with pytest.raises(pgm.EvidenceError, match=r"this posterior is filtered: take pgm\.smooth"):
        pgm.filter(model(), READ).sample(2, rng=0)
    posterior = pgm.smooth(model(), READ)
    with pytest.raises(pgm.EvidenceError, match="filtered"):
        posterior.filtered.sample(2, rng=0)
    with pytest.raises(pgm.EvidenceError, match=r"fixed-lag \(2\)"):
        pgm.smooth(model(), READ, lag=2).sample(2, rng=0)
    with pytest.raises(pgm.ModelError, match="draw fewer at a time"):
        posterior.sample(10**13, rng=0)
