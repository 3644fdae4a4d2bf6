"""Diagrams: networks and cluster graphs, laid out in points, and written in DOT."""
