"""What the benchmark compares must be the same work."""

from benchmarks import work
from benchmarks.__main__ import check, online
from models.networks import pose


def test_the_libraries_agree():
    check(work.range_bearing(3, 20))


def test_online_ends_where_the_filter_does():
    import numpy as np

    import pgm

    task = work.range_bearing(1, 20)
    posterior = pgm.filter(task.network, task.evidence(0))
    np.testing.assert_allclose(online(task)[pose].mean, posterior[pose].mean[-1], atol=1e-12)
