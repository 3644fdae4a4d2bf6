"""In and out: a user's own log becomes evidence.

`pgm.io.networks` has files of networks, `pgm.io.tum` files of trajectories.
"""

from pgm.io.controls import ControlReport
from pgm.io.readings import ReadingReport
from pgm.io.stamped import Stamped, stamped
from pgm.io.timeline import Timeline, timeline

__all__ = ["ControlReport", "ReadingReport", "Stamped", "Timeline", "stamped", "timeline"]
