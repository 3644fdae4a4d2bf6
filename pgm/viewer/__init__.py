"""Self-contained pages of a posterior: its graph, beliefs and messages; and how far it is right."""

from pgm.viewer.report import report
from pgm.viewer.view import html, view

__all__ = ["html", "report", "view"]
