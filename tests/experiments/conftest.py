"""Figures of experiments that nobody looks at are drawn coarsely."""

import pytest

from experiments import record


@pytest.fixture(autouse=True, scope="session")
def coarse():
    fine, record.DPI = record.DPI, 40
    yield
    record.DPI = fine
