"""Users' functions traced to graphs of scalar operations, for derivatives and compilation."""

from pgm.tracing.judging import Answers, Judge, judged
from pgm.tracing.program import Program
from pgm.tracing.slopes import Points, Slopes, beside
from pgm.tracing.trace import Tracer, trace

__all__ = [
    "Answers",
    "Judge",
    "Points",
    "Program",
    "Slopes",
    "Tracer",
    "beside",
    "judged",
    "trace",
]
