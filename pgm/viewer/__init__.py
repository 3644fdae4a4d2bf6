"""One self-contained page of a posterior: its cluster graph, every belief and every message."""

from pgm.viewer.view import html, view

__all__ = ["html", "view"]
