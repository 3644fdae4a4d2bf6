"""Curves of statistics: errors, consistency, divergences, residuals."""
