"""Users' functions as graphs of scalar operations, and what comes of them."""

from pgm.tracing.program import Program
from pgm.tracing.trace import Tracer, trace

__all__ = ["Program", "Tracer", "trace"]
