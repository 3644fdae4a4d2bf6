"""What the benchmark compares must be the same work."""

import pytest

from benchmarks import discrete, work
from benchmarks.__main__ import check, online
from models.networks import pose


def test_the_libraries_agree():
    check(work.range_bearing(3, 20))


@pytest.mark.parametrize("name", ["asia", "random_200"])
def test_pyagrum_agrees_about_discrete_networks(name):
    pytest.importorskip("pyagrum", reason="pyagrum comes with the extra bench")
    discrete.check(discrete.tasks()[name])


def test_online_ends_where_the_filter_does():
    import numpy as np

    import pgm

    task = work.range_bearing(1, 20)
    posterior = pgm.filter(task.network, task.evidence(0))
    np.testing.assert_allclose(online(task)[pose].mean, posterior[pose].mean[-1], atol=1e-12)
