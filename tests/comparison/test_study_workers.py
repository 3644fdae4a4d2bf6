"""Studies by workers, and studies that go on from a file: the digits of one whole call."""

import os
import pickle
import signal
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from functools import lru_cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from comparison.test_study import INPUTS, METHODS, ROBOT, m, move, p, r, sight, u
from numpy.testing import assert_array_equal

import pgm
from pgm.comparison import drawn_runs, kept_sums
from pgm.comparison.fingerprint import fingerprint
from pgm.errors import ExecutorError, FileError, LinearisationError, ModelError
from pgm.examples import walk, x, z

RUNS = 30


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    """Four blocks, each of which is written at once."""
    monkeypatch.setattr(drawn_runs, "MOST", 8)
    monkeypatch.setattr(kept_sums, "_APART", 0.0)


def robots(runs=RUNS, **given):
    given = {"model": ROBOT, "evidence": INPUTS, "methods": METHODS, "seed": 5, **given}
    return pgm.study(runs=runs, **given)


@pytest.fixture
def whole():
    return robots()


def require_same(found, due):
    assert len(found.rows) == len(due.rows)
    for row, other in zip(found.rows, due.rows, strict=True):
        assert (row.method, row.state, row.runs) == (other.method, other.state, other.runs)
        assert (row.unsettled, row.worst) == (other.unsettled, other.worst)
        assert_array_equal(row.diverged, other.diverged)
        assert_array_equal(row.failed, other.failed)
        for name, statistic in row._statistics().items():
            its = other._statistics()[name]
            for each in ("value", "error", "by_step", "error_by_step"):
                assert_array_equal(getattr(statistic, each), getattr(its, each))


class Stopped(Exception):
    """The end of a call, from its progress."""


def stopped_after(blocks, **given):
    def progress(done, total):
        if done == blocks:
            raise Stopped

    with pytest.raises(Stopped):
        robots(progress=progress, **given)


@pytest.mark.parametrize("kind", ["threads", "processes"])
def test_workers_change_no_digit(kind, whole):
    with (
        ThreadPoolExecutor(2) if kind == "threads" else ProcessPoolExecutor(2, get_context("fork"))
    ) as executor:
        require_same(robots(executor=executor), whole)


def test_dask_changes_no_digit(whole):
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, processes=False, dashboard_address="127.0.0.1:0"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        require_same(robots(executor=client.get_executor()), whole)
        with pytest.raises(ModelError, match=r"client\.get_executor\(\)"):
            robots(executor=client)


def test_workers_take_work_apart_once():
    """The model that a worker has is the same for all blocks, with what was traced of it."""
    from pgm.comparison.blocks import _Packed

    packed = _Packed(ROBOT)
    one, other = (pickle.loads(pickle.dumps(packed)) for _ in range(2))
    assert one.work is other.work
    assert one.work is not ROBOT


def test_what_workers_cannot_have_is_named():
    sensor = pgm.NonlinearGaussianCPD(z, x, lambda x: x + 0.0, cov=2.0)
    model = walk.replace(observation=[sensor])
    given = {"steps": 2, "runs": 20, "methods": {"EKF": pgm.Taylor()}, "seed": 1}
    with (
        ProcessPoolExecutor(1, get_context("fork")) as executor,
        pytest.raises(ModelError, match=r"p\(z \| x\).*|NonlinearGaussianCPD\(z \| x\)"),
    ):
        pgm.study(model, executor=executor, **given)


def never(x):
    return np.full((*x.shape, 1), np.nan)


def same_value(x):
    return x + 0.0


def ending(x):
    os._exit(3)


def test_errors_of_workers_are_raised_here():
    sensor = pgm.NonlinearGaussianCPD(z, x, same_value, cov=2.0, jacobian={x: never})
    given = {"steps": 2, "runs": 20, "methods": {"EKF": pgm.Taylor()}, "seed": 1}
    with ProcessPoolExecutor(1, get_context("fork")) as executor:
        with pytest.raises(LinearisationError, match="run 0") as caught:
            pgm.study(walk.replace(observation=[sensor]), executor=executor, **given)
        assert caught.value.cpd is sensor
        sensor = pgm.NonlinearGaussianCPD(z, x, same_value, cov=2.0, jacobian={x: ending})
        with pytest.raises(ExecutorError, match="runs 0 to 19 were lost"):
            pgm.study(walk.replace(observation=[sensor]), executor=executor, **given)


@pytest.mark.parametrize("blocks", [0, 1, 2, 3])
def test_a_study_that_was_stopped_goes_on(blocks, whole, tmp_path, monkeypatch):
    file = tmp_path / "study.npz"
    stopped_after(blocks, file=file)
    worked, sample = [], drawn_runs.DrawnRuns.sample

    def counted(self, first):
        worked.append(first)
        return sample(self, first)

    monkeypatch.setattr(drawn_runs.DrawnRuns, "sample", counted)
    require_same(robots(file=file), whole)
    # The first once more, and those that are left.
    assert worked == [0] * (blocks > 0) + [*range(8 * blocks, RUNS, 8)]
    worked.clear()
    require_same(
        robots(file=str(file), methods=dict(reversed(METHODS.items()))),
        robots(methods=dict(reversed(METHODS.items()))),
    )
    assert worked[:2] == [0, 24]  # three whole blocks were kept


def test_a_stopped_study_goes_on_by_workers(whole, tmp_path):
    file = tmp_path / "study.npz"
    stopped_after(1, file=file)
    with ThreadPoolExecutor(2) as executor:
        require_same(robots(file=file, executor=executor), whole)


PROGRAM = """
import os, signal, sys
from comparison.test_study_workers import drawn_runs, kept_sums, robots
drawn_runs.MOST, kept_sums._APART = 8, 0.0
def progress(done, total):
    if done == 2:
        os.kill(os.getpid(), signal.SIGKILL)
robots(file=sys.argv[1], progress=progress)
"""


def test_a_killed_study_goes_on_in_another_process(whole, tmp_path):
    file, root = tmp_path / "study.npz", Path(__file__).parents[2]
    paths = os.pathsep.join([str(root), str(root / "tests")])
    environment = {**os.environ, "PYTHONPATH": paths, "PYTHONHASHSEED": "77"}
    done = subprocess.run([sys.executable, "-c", PROGRAM, str(file)], env=environment, check=False)
    assert done.returncode == -signal.SIGKILL
    told = []
    require_same(robots(file=file, progress=lambda done, total: told.append((done, total))), whole)
    assert told[-1] == (2, 2)
    assert [each.name for each in tmp_path.iterdir()] == ["study.npz"]


def test_a_longer_study_goes_on_from_a_shorter_one(tmp_path):
    file = tmp_path / "study.npz"
    robots(21, file=file)
    require_same(robots(RUNS, file=file), robots(RUNS))
    with pytest.raises(FileError, match="has 24 runs, and 20 are asked for"):
        robots(20, file=file)


def far(limit):
    """A sensor that no run of the tests tells from `sight`."""

    def seen(p, m):
        return np.where(p[..., :1] > limit, 0.0, sight(p, m))

    return seen


def seen_by(function):
    return ROBOT.replace(
        observation=[
            pgm.NonlinearGaussianCPD(r, (p, m), function, cov=[0.1, 0.05], noise=pgm.StudentT(5.0))
        ]
    )


OTHERS = {
    "seed 5, here 6": {"seed": 6},
    "confidence 0.95, here 0.9": {"confidence": 0.9},
    "compiled None, here False": {"compiled": False},
    "method EKF Taylor, Filtering .*, here none": {"methods": {"UKF": pgm.Unscented()}},
    "method EKF Taylor, Filtering .*, here Unscented, Filtering": {
        "methods": METHODS | {"EKF": pgm.Unscented()}
    },
    "the method URTS has other numbers": {
        "methods": METHODS | {"URTS": (pgm.Unscented(alpha=0.5), pgm.Smoothing())}
    },
    "the model has other numbers or functions": {
        "model": ROBOT.replace(prior=[pgm.GaussianCPD(p, [0.0, 3.0], [0.1, 0.021])])
    },
    "the evidence has other numbers": {"evidence": INPUTS | {u: np.full((6, 1), 0.31)}},
    "steps 6, here 7": {
        "evidence": {u: np.full((7, 1), 0.3), r: INPUTS[r]},
    },
}


@pytest.mark.parametrize("message", OTHERS)
def test_a_file_of_another_study_is_refused(message, tmp_path):
    file = tmp_path / "study.npz"
    stopped_after(2, file=file)
    before = file.read_bytes()
    with pytest.raises(FileError, match=f"is of another study: .*{message}"):
        robots(file=file, **OTHERS[message])
    assert file.read_bytes() == before


def test_another_function_is_refused_though_no_run_tells(tmp_path):
    file = tmp_path / "study.npz"
    stopped_after(1, file=file, model=seen_by(far(1e6)))
    with pytest.raises(FileError, match="the model has other numbers or functions"):
        robots(file=file, model=seen_by(far(1e7)))
    require_same(robots(file=file, model=seen_by(far(1e6))), robots(model=seen_by(far(1e6))))


def test_figures_that_arguments_do_not_tell_are_refused(tmp_path):
    scale = [1.0]

    @lru_cache(0)
    def factor():
        return scale[0]

    def seen(p, m):
        return factor() * sight(p, m)

    file = tmp_path / "study.npz"
    stopped_after(1, file=file, model=seen_by(seen))
    scale[0] = 1.5
    with pytest.raises(FileError, match="the first block has other figures now"):
        robots(file=file, model=seen_by(seen))


def test_damaged_files_are_refused(tmp_path, whole):
    file = tmp_path / "study.npz"
    stopped_after(2, file=file)
    content = file.read_bytes()
    rng = np.random.default_rng(4)
    refused = 0
    for place in rng.integers(len(content), size=40):
        file.write_bytes(content[:place])
        with pytest.raises(FileError, match=r"study\.npz: it is no file of a study, or damaged"):
            robots(file=file)
        turned = bytearray(content)
        turned[place] ^= 1 << int(rng.integers(8))
        file.write_bytes(turned)
        try:
            require_same(robots(file=file), whole)  # of a date within the archive nothing depends
        except FileError:
            refused += 1
    assert refused > 20
    for other in (b"", b"not an archive", pickle.dumps([1])):
        file.write_bytes(other)
        with pytest.raises(FileError, match="no file of a study, or damaged"):
            robots(file=file)
    np.savez(file, kind=np.array("something else"))
    with pytest.raises(FileError, match="its kind is something else"):
        robots(file=file)


def test_files_that_cannot_be_written_are_refused_before_work(tmp_path, monkeypatch):
    def never(*_):
        raise AssertionError("worked")

    monkeypatch.setattr(drawn_runs.DrawnRuns, "sample", never)
    with pytest.raises(FileError, match="the study cannot be kept there"):
        robots(file=tmp_path / "none" / "study.npz")
    with pytest.raises(FileError, match="no file of a study"):
        robots(file=tmp_path)
    with pytest.raises(ModelError, match="file= is the path of a file"):
        robots(file=3)


def test_methods_of_any_name_are_kept(tmp_path):
    methods = {"a/b": pgm.Taylor(), "0.npy": pgm.Unscented(), "": pgm.Cubature()}
    file = tmp_path / "study.npz"
    stopped_after(2, file=file, methods=methods)
    require_same(robots(file=file, methods=methods), robots(methods=methods))


def test_fingerprints_tell_numbers_and_code_but_no_lines():
    def of(code):
        names = {"np": np, "move": move, "__name__": "drives"}
        exec(code, names)
        return fingerprint(names["f"])

    plain = "def f(x):\n    return x + 1.0"
    assert of(plain) == of("\n\n" + plain)
    assert of(plain) != of(plain.replace("1.0", "2.0"))
    assert of(plain) != of(plain.replace("+", "-"))
    helped = "def g(x):\n    return 2.0 * x\ndef f(x):\n    return g(x)"
    assert of(helped) != of(helped.replace("2.0", "3.0"))
    default = "def f(x, a=1.0):\n    return x + a"
    assert of(default) != of(default.replace("1.0", "2.0"))
    within = "def f(x):\n    return (lambda y: y * a)(x)\na = 1.0"
    assert of(within) != of(within.replace("1.0", "2.0"))
    again = "def f(x):\n    return f(x - 1) if x > 0 else 0"
    assert of(again) == of(again)
    called = "class F:\n    def __call__(self, x):\n        return x + 1.0\nf = F()"
    assert of(called) == of(called)
    assert of(called) != of(called.replace("1.0", "2.0"))
    values = [np.zeros(2), np.zeros(2, dtype=np.float32), np.zeros((2, 1)), [0.0, 0.0], 0.0, None]
    values += [{"a": 1}, {"a": 2}, {1, 2}, pgm.Unscented(), pgm.Unscented(alpha=0.5), walk.prior]
    assert len({fingerprint(each) for each in values}) == len(values)
