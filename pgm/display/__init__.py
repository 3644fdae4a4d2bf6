"""Summaries of values: a few lines, as text and in HTML."""

from pgm.display.moments import axes, by_component, named_matrix, stacked, whereabouts
from pgm.display.shown import (
    Drawn,
    InCode,
    NoArray,
    Shown,
    as_numbers,
    beside,
    brief,
    called,
    column,
    count,
    number,
    table,
    titled,
    vector,
)
from pgm.display.summary import ENDS, LEFT_OUT, TITLE, Listing, Summary, few, places

__all__ = [
    "ENDS",
    "LEFT_OUT",
    "TITLE",
    "Drawn",
    "InCode",
    "Listing",
    "NoArray",
    "Shown",
    "Summary",
    "as_numbers",
    "axes",
    "beside",
    "brief",
    "by_component",
    "called",
    "column",
    "count",
    "few",
    "named_matrix",
    "number",
    "places",
    "stacked",
    "table",
    "titled",
    "vector",
    "whereabouts",
]
