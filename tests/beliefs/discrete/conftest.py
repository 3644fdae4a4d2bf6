"""Each test twice: of graphs asked for the first time, and of graphs that were asked before."""

import pytest

from pgm.beliefs.discrete import first_beliefs


@pytest.fixture(params=["first question", "asked before"], autouse=True, scope="module")
def _asked(request):
    """Make every question seem to be another than the first."""
    with pytest.MonkeyPatch.context() as patched:
        if request.param == "asked before":
            patched.setattr(first_beliefs, "_first", lambda graph: False)
        yield
