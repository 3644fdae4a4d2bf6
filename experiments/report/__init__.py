"""Every experiment run, and one page with all they found."""

from experiments.report.command import report

__all__ = ["report"]
