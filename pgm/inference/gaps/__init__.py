"""Evidence with gaps: networks without time whose runs were not all observed in the same cells.

Runs are grouped by their pattern of gaps (`pgm.evidence.cells`), and the network is solved once for
each, by the family of beliefs that its CPDs ask for (`run`). A variable that was observed in part
has an exact reading of its known components (`readings`). The results of all patterns are one
outcome, in the order of the runs (`outcome`).
"""

from pgm.inference.gaps.run import run

__all__ = ["run"]
