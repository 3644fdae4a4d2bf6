"""Schedules of messages on any graph: what they send, when they stop, what they say of it."""

import numpy as np
import pytest

import pgm
from pgm.schedules.loopy import run_loopy
from pgm.schedules.rounds import Directed

KINDS = (pgm.Flooding, pgm.Sequential, pgm.Residual)
kinds = pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)


@kinds
@pytest.mark.parametrize("count", [0, -1, True, 1.5, "many", None])
def test_iterations_are_counted(kind, count):
    with pytest.raises(pgm.ModelError, match=r"iterations must be a whole number, 1 or more"):
        kind(iterations=count)


@kinds
@pytest.mark.parametrize("tolerance", [-1e-12, np.nan, -np.inf])
def test_a_tolerance_is_not_negative(kind, tolerance):
    with pytest.raises(pgm.ModelError, match="a tolerance must be 0 or more"):
        kind(tolerance=tolerance)


@kinds
@pytest.mark.parametrize("damping", [-0.1, 1.0, 2.0, np.nan])
def test_damping_leaves_something_of_the_new_message(kind, damping):
    with pytest.raises(pgm.ModelError, match=r"damping is the share of the old message, in \[0, 1"):
        kind(damping=damping)


@pytest.mark.parametrize("kind", [pgm.Calibration, pgm.Smoothing])
@pytest.mark.parametrize("count", [0, True, 2.0])
def test_linearisations_are_counted(kind, count):
    with pytest.raises(pgm.ModelError, match="which count linearisations"):
        kind(iterations=count)


@kinds
def test_schedules_are_values(kind):
    assert kind() == kind(tolerance=1e-10, damping=0.0, iterations=1000)
    assert kind(damping=0.5) != kind()
    with pytest.raises(AttributeError):
        kind().damping = 0.5


def test_a_status_tells_how_it_went():
    residuals = np.array([[1.0, 2.0], [1e-11, 0.5]])
    status = pgm.results.Status(2, residuals, np.array([True, False]))
    title, worst = repr(status).splitlines()
    assert title == "Status(2 iterations, 1 of 2 runs converged, last residual 0.5)"
    assert worst == "  residuals of the worst run: 2, 0.5"
    once = pgm.results.Status(1, residuals[:1], np.array([False, False]))
    assert repr(once) == "Status(1 iteration, 0 of 2 runs converged, last residual 2)"
    with pytest.raises(ValueError, match="read-only"):
        status.residuals[0, 0] = 0.0


class Averages:
    """Messages that are numbers: each goes to a share of those it is made of, plus its own part.

    It counts what is sent, and knows no Gaussians.
    """

    def __init__(self, share, own, edges, damping=0.0, moves=()):
        ends = np.array(edges)
        count = int(ends.max()) + 1
        self.directed = Directed(ends.ravel(), ends[:, ::-1].ravel(), count)
        self.share, self.own, self.damping = share, np.asarray(own, float), damping
        self.kept = np.zeros(self.own.shape)
        self.moves = list(moves)
        self.sent, self.asked, self.proposed = [], [], None

    bounded = False

    @property
    def runs(self):
        return self.own.shape[1]

    def round(self, messages):
        return list(messages)

    def new(self, messages):
        inputs = [self.kept[self.directed.inputs(m)].sum(axis=0) for m in messages]
        return self.own[messages] + self.share * np.array(inputs).reshape(len(messages), -1)

    def propose(self, round):
        self.asked.append(round)
        self.proposed = self.new(round)
        return np.abs(self.proposed - self.kept[round])

    def accept(self, round, active, lost):
        self.sent.append(round)
        mixed = self.damping * self.kept[round] + (1 - self.damping) * self.proposed
        self.kept[round] = np.where(active, mixed, self.kept[round])

    def relinearise(self, active):
        return self.moves.pop(0) if self.moves else None

    def fixed_point(self):
        count = len(self.directed)
        matrix = np.eye(count)
        for m in range(count):
            matrix[m, self.directed.inputs(m)] -= self.share
        return np.linalg.solve(matrix, self.own)


RING = [(0, 1), (1, 2), (2, 3), (0, 3)]
CHAIN = [(0, 1), (1, 2), (2, 3)]


def ring(share=0.5, runs=1, damping=0.0, edges=RING):
    own = np.random.default_rng(0).normal(size=(2 * len(edges), runs))
    return Averages(share, own, edges, damping)


@kinds
@pytest.mark.parametrize("damping", [0.0, 0.3, 0.7, 0.9])
@pytest.mark.parametrize("edges", [RING, CHAIN, CHAIN[:1]], ids=["ring", "chain", "edge"])
def test_converged_means_that_no_message_would_change(kind, damping, edges):
    """Damped messages too: a small step taken is no small step due."""
    messages = ring(runs=3, damping=damping, edges=edges)
    schedule = kind(damping=damping)
    status = run_loopy(messages, schedule, (3,))
    assert status.converged.all()
    assert status.residuals.shape == (status.iterations, 3)
    assert (status.residuals[-1] <= schedule.tolerance).all()
    due = np.abs(messages.new(range(2 * len(edges))) - messages.kept)
    assert due.max() < 3 * schedule.tolerance
    np.testing.assert_allclose(messages.kept, messages.fixed_point(), atol=1e-9)


@kinds
def test_the_last_iteration_is_the_last(kind):
    messages = ring()
    status = run_loopy(messages, kind(iterations=4), ())
    assert status.iterations == 4
    assert not status.converged
    assert status.residuals[-1] > 1e-10


@kinds
def test_what_diverges_is_stopped_and_said_to_have_diverged(kind):
    messages = ring(share=3.0)
    status = run_loopy(messages, kind(iterations=10_000), ())
    assert status.iterations < 1000
    assert not status.converged
    assert status.residuals[-1] > 1e4 * status.residuals.min()
    assert np.isfinite(messages.kept).all()


def test_flooding_sends_all_messages_at_once():
    messages = ring()
    status = run_loopy(messages, pgm.Flooding(iterations=5), ())
    assert messages.sent == [list(range(8))] * status.iterations


def test_sequential_sends_each_message_once_an_iteration():
    messages = ring()
    status = run_loopy(messages, pgm.Sequential(iterations=3), ())
    sent = [m for each in messages.sent for m in each]
    assert len(sent) == 8 * status.iterations
    for k in range(status.iterations):
        assert sorted(sent[8 * k : 8 * (k + 1)]) == list(range(8))


def test_sequential_goes_forth_and_back():
    messages = ring()
    run_loopy(messages, pgm.Sequential(iterations=1), ())
    ends = [
        (int(messages.directed.source[m]), int(messages.directed.target[m]))
        for each in messages.sent
        for m in each
    ]
    assert ends == [(0, 1), (0, 3), (1, 2), (2, 3), (3, 2), (3, 0), (2, 1), (1, 0)]


def of_turns(*turns):
    """A schedule of one's own that sends some groups of messages."""

    class Own(pgm.Loopy):
        def turns(self, messages):
            return turns

    return Own(iterations=3)


def test_an_order_of_ones_own_is_sent_as_it_is():
    messages = ring()
    status = run_loopy(messages, of_turns([3, 1], [0], [7, 6, 5], [4, 2]), ())
    assert messages.sent == [[3, 1], [0], [7, 6, 5], [4, 2]] * status.iterations


def test_a_message_that_is_sent_twice_has_its_larger_change():
    there, again = ring(), ring()
    single = run_loopy(there, of_turns(*([m] for m in range(8))), ())
    twice = run_loopy(again, of_turns(*([m] for m in (*range(8), 0))), ())
    assert twice.residuals[0] == single.residuals[0]


@pytest.mark.parametrize(
    ("turns", "text"),
    [
        ([range(7)], r"leaves out the messages \[7\], which would never be sent"),
        ([range(9)], "has 8, which is no message"),
        ([range(8), [-1]], "has -1, which is no message"),
        ([range(8), ["a"]], "has 'a', which is no message"),
        ([[0, 0, *range(1, 8)]], "has a message twice in one group"),
        ([3], r"groups of the numbers 0 to 7 of messages, as \[\[0, 1\], \[2\]\], were due"),
    ],
)
def test_turns_are_groups_of_messages(turns, text):
    with pytest.raises(pgm.ModelError, match=text):
        run_loopy(ring(), of_turns(*turns), ())


def test_residual_sends_the_message_that_would_change_most():
    messages = ring(runs=2, damping=0.3)
    largest = []

    class Watched(Averages):
        def accept(self, round, active, lost):
            due = np.abs(self.new(range(8)) - self.kept).max(axis=1)
            largest.append((due[round[0]], due.max()))
            super().accept(round, active, lost)

    messages.__class__ = Watched
    run_loopy(messages, pgm.Residual(iterations=6, damping=0.3), (2,))
    sent = [m for each in messages.sent for m in each]
    assert len(sent) == 6 * 8
    for taken, most in largest:
        assert taken == pytest.approx(most, rel=1e-12)


def test_residual_looks_at_the_runs_that_are_active():
    """One run has converged from the start; its messages decide nothing."""
    messages = Averages(0.5, np.array([[0.0, 1.0]] * 8), RING)
    messages.own[:, 0] = 0.0
    status = run_loopy(messages, pgm.Residual(), (2,))
    assert status.converged.all()
    np.testing.assert_allclose(messages.kept, messages.fixed_point(), atol=1e-9)


@kinds
def test_runs_that_have_converged_are_left_alone(kind):
    """One run starts where it ends."""
    messages = ring(runs=2)
    messages.own[:, 0] *= 1e-11
    status = run_loopy(messages, kind(), (2,))
    assert status.converged.all()
    early = np.flatnonzero(status.residuals[:, 0] <= 1e-10)[0]
    assert early + 1 < status.iterations
    assert (status.residuals[early:, 0] == status.residuals[early, 0]).all()
    alone = ring(runs=2)
    alone.own = messages.own[:, :1]
    alone.kept = np.zeros_like(alone.own)
    assert run_loopy(alone, kind(), ()).iterations == early + 1
    if kind is not pgm.Residual:
        np.testing.assert_array_equal(alone.kept, messages.kept[:, :1])


@kinds
def test_no_run_has_converged_whose_means_still_move(kind):
    """Messages that agree at once, relinearisations that do not."""
    moves = [np.array([10.0**-k]) for k in range(14)]
    messages = Averages(0.0, np.zeros((8, 1)), RING, moves=moves)
    status = run_loopy(messages, kind(), ())
    assert status.converged
    assert status.iterations == 11
    assert messages.moves[0] == 1e-11


def test_messages_are_made_of_all_that_arrives_but_from_the_target():
    directed = ring().directed
    for m in range(len(directed)):
        source, target = directed.source[m], directed.target[m]
        assert (directed.source[m ^ 1], directed.target[m ^ 1]) == (target, source)
        for other in directed.inputs(m):
            assert directed.target[other] == source
            assert directed.source[other] != target
        for other in range(len(directed)):
            assert (other in directed.dependents(m)) == (m in directed.inputs(other))


@pytest.mark.parametrize("runs", [(), (3,)])
def test_the_status_says_which_edges_still_change(runs):
    a, b, c, d = pgm.variables("a b c d")
    net = pgm.BayesianNetwork(
        [
            pgm.GaussianCPD(a, 0.0, 1.0),
            pgm.LinearGaussianCPD(b, given={a: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(c, given={a: 1.0}, cov=1.0),
            pgm.LinearGaussianCPD(d, given={b: 1.0, c: -2.0}, cov=1.0),
        ]
    )
    sepsets = {(0, 1): {a}, (0, 2): {b}, (1, 2): {c}}
    graph = pgm.ClusterGraph(net, [{a, b}, {a, c}, {b, c, d}], sepsets=sepsets)
    evidence = {d: np.ones((*runs, 1))}
    settled = pgm.infer(graph, evidence, schedule=pgm.Flooding()).status
    assert settled.by_edge.keys() == sepsets.keys()
    assert all(change.shape == runs for change in settled.by_edge.values())
    assert max(change.max() for change in settled.by_edge.values()) <= 1e-10
    with pytest.warns(pgm.ConvergenceWarning, match="after 2 rounds"):
        early = pgm.infer(graph, evidence, schedule=pgm.Flooding(iterations=2)).status
    assert max(change.max() for change in early.by_edge.values()) > 1e-6
    tree = pgm.infer(pgm.compile(net), evidence).status
    assert not tree.by_edge
