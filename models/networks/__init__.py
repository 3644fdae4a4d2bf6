"""Declared networks: robots in the plane that localise themselves, and targets to track."""

from models.networks.drives import differential_drive, turn_after_move
from models.networks.landmarks import odometry_ranges, range_bearing, range_only
from models.networks.observations import (
    reads_heading,
    reads_pose,
    reads_position,
    sees_bearing,
    sees_landmark,
    sees_range,
)
from models.networks.points import linear, linear_velocity
from models.networks.poses import velocity_pose, velocity_position
from models.networks.targets import constant_velocity, coordinated_turn
from models.networks.variables import (
    bearing,
    compass,
    distance,
    fix,
    landmark,
    move,
    odometry,
    point,
    pose,
    pose_fix,
    shift,
    sighting,
    speed,
    target,
    travelled,
    turning_target,
    velocity,
    wheels,
)

__all__ = [
    "bearing",
    "compass",
    "constant_velocity",
    "coordinated_turn",
    "differential_drive",
    "distance",
    "fix",
    "landmark",
    "linear",
    "linear_velocity",
    "move",
    "odometry",
    "odometry_ranges",
    "point",
    "pose",
    "pose_fix",
    "range_bearing",
    "range_only",
    "reads_heading",
    "reads_pose",
    "reads_position",
    "sees_bearing",
    "sees_landmark",
    "sees_range",
    "shift",
    "sighting",
    "speed",
    "target",
    "travelled",
    "turn_after_move",
    "turning_target",
    "velocity",
    "velocity_pose",
    "velocity_position",
    "wheels",
]
