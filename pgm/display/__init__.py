"""What values look like: summaries of a few lines, as text and in HTML."""

from pgm.display.matrices import matrix
from pgm.display.moments import axes, by_component, stacked, whereabouts
from pgm.display.numbers import beside, column, count, number
from pgm.display.places import few, places
from pgm.display.shown import InCode, NoArray, Shown
from pgm.display.summary import Listing, Summary

__all__ = [
    "InCode",
    "Listing",
    "NoArray",
    "Shown",
    "Summary",
    "axes",
    "beside",
    "by_component",
    "column",
    "count",
    "few",
    "matrix",
    "number",
    "places",
    "stacked",
    "whereabouts",
]
