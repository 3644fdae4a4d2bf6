"""Words by counters are NumPy's Philox, and the numbers of them have their distributions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy import stats

from pgm.kernels import philox

LAST = 2**64 - 1


@pytest.mark.parametrize("counter", [(0, 0, 0, 0), (1, 2, 3, 4), (LAST, 5, LAST, 7)])
@pytest.mark.parametrize("seed", [0, 2**70 + 1])
def test_words_are_numpys(seed, counter):
    source = philox.Philox(seed)
    source.words((9, 9, 9, 9), 3)  # leaves nothing behind
    due = np.random.Philox(key=source.key, counter=np.array(counter, dtype=np.uint64)).random_raw(
        11
    )
    assert_array_equal(source.words(counter, 11), due)
    assert_array_equal(source.key, np.random.Philox(seed).state["state"]["key"])


def test_the_words_of_a_known_answer():
    """The first test vector of the authors' library, kat_vectors, of counter and key zero."""
    source = philox.Philox(0)
    source._state["state"]["key"] = np.zeros(2, dtype=np.uint64)
    # NumPy adds one to the counter before it takes its words.
    words = source.words((LAST, LAST, LAST, LAST), 4)
    due = [0x16554D9ECA36314C, 0xDB20FE9D672D0FDC, 0xD7E772CEE186176B, 0x7E68B68AEC7BA23B]
    assert words.tolist() == due


def test_uniforms_are_inside_the_interval_and_symmetric():
    ends = philox.uniforms(np.array([0, LAST], dtype=np.uint64))
    assert ends[0] > 0.0
    assert ends[1] < 1.0
    assert ends[0] == 1.0 - ends[1]
    assert_allclose(np.abs(philox.normals(ends)), 8.21, atol=0.01)


def test_numbers_have_their_distributions():
    uniform = philox.uniforms(philox.Philox(3).words((0, 1, 2, 3), 4000))
    found = {
        "uniform": (uniform, stats.uniform),
        "normal": (philox.normals(uniform), stats.norm),
        "chi-square": (philox.chi_squares(uniform, 3.5), stats.chi2(3.5)),
    }
    for numbers, law in found.values():
        assert stats.kstest(numbers, law.cdf).pvalue > 0.01
