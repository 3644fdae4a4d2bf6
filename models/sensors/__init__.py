"""Sensors of a planar robot: the state is x = (east [m], north [m], heading θ [rad]).

Landmarks are m = (east [m], north [m]). Functions are called ``function(x)`` or ``function(x, m)``
with equal leading axes (``...``) and return ``(..., d)``. The Jacobians ``function_by_state``
``(..., d, 3)`` and ``function_by_landmark`` ``(..., d, 2)`` take the same arguments.

At the landmark itself a range has no derivative and a bearing means nothing: it is what atan2 makes
of two zeros, less the heading. The Jacobians there are NaN, without a warning, so that whoever
linearises there finds it out.

A `Sensor` keeps a function and its derivatives together: `mounted` puts it elsewhere on the robot,
`calibrated` gives it a scale and an offset, each as numbers or as one more parent.
"""

from models.sensors.ideal import (
    bearing_only,
    bearing_only_by_landmark,
    bearing_only_by_state,
    heading,
    heading_by_state,
    pose,
    pose_by_state,
    position,
    position_by_state,
    range_bearing,
    range_bearing_by_landmark,
    range_bearing_by_state,
    range_only,
    range_only_by_landmark,
    range_only_by_state,
)
from models.sensors.real import (
    BEARING,
    HEADING,
    POSE,
    POSITION,
    RANGE,
    RANGE_BEARING,
    Sensor,
    calibrated,
    mounted,
)

__all__ = [
    "BEARING",
    "HEADING",
    "POSE",
    "POSITION",
    "RANGE",
    "RANGE_BEARING",
    "Sensor",
    "bearing_only",
    "bearing_only_by_landmark",
    "bearing_only_by_state",
    "calibrated",
    "heading",
    "heading_by_state",
    "mounted",
    "pose",
    "pose_by_state",
    "position",
    "position_by_state",
    "range_bearing",
    "range_bearing_by_landmark",
    "range_bearing_by_state",
    "range_only",
    "range_only_by_landmark",
    "range_only_by_state",
]
