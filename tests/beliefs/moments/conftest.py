"""Fixtures of tests of chains in moment form."""

import pytest

from pgm.beliefs.moments.passes import forward


@pytest.fixture
def alone(monkeypatch):
    """The general kernels refused, but to choices that are not compiled."""
    stepwise = forward._stepwise

    def refused(plan, *arguments, **options):
        assert plan.layout.compiled is False, "runs were left to the general kernels"
        return stepwise(plan, *arguments, **options)

    monkeypatch.setattr(forward, "_stepwise", refused)
