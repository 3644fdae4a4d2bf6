"""Users' functions as graphs of scalar operations, and what comes of them."""

from pgm.tracing.judging import Answers, Judge, beside, judged
from pgm.tracing.program import Program
from pgm.tracing.trace import Tracer, trace

__all__ = ["Answers", "Judge", "Program", "Tracer", "beside", "judged", "trace"]
