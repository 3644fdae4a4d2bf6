"""Users' functions traced to graphs of scalar operations, for derivatives and compilation."""

from pgm.tracing.judging import Answers, Judge, beside, judged
from pgm.tracing.program import Program
from pgm.tracing.trace import Tracer, trace

__all__ = ["Answers", "Judge", "Program", "Tracer", "beside", "judged", "trace"]
