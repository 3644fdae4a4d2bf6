"""Summaries of values: a few lines, as text and in HTML."""

from pgm.display.brief import (
    as_numbers,
    beside,
    brief,
    called,
    column,
    count,
    number,
    table,
    vector,
)
from pgm.display.moments import axes, by_component, named_matrix, stacked, whereabouts
from pgm.display.notebook import Drawn, Judged, Viewed
from pgm.display.shown import ByAttributes, InCode, NoArray, Shown, titled
from pgm.display.summary import ENDS, LEFT_OUT, TITLE, Listing, Summary, few, places
from pgm.display.told import Told

__all__ = [
    "ENDS",
    "LEFT_OUT",
    "TITLE",
    "ByAttributes",
    "Drawn",
    "InCode",
    "Judged",
    "Listing",
    "NoArray",
    "Shown",
    "Summary",
    "Told",
    "Viewed",
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
