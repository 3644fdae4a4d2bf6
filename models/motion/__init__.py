"""How a planar robot moves: the state is x = (east [m], north [m], heading θ [rad]).

Each model turns its control u into a step seen from the robot, b(u), and a turn φ(u):

    p' = p + R(θ) b(u),    θ' = θ + φ(u).

So ∂p'/∂θ is the step R(θ) b turned by a quarter, whatever the model. Headings are anticlockwise
from east and stay on one unwrapped chart: no model wraps them.

Functions are called ``function(x, u)`` with equal leading axes (``...``) and return ``(..., 3)``.
The Jacobians ``function_by_state`` and ``function_by_control`` take the same arguments and return
``(..., 3, 3)`` and ``(..., 3, d)`` for a control of d components: rows are the components of x',
columns those of x or of u.
"""

from models.motion.arcs import (
    Velocity,
    arc,
    arc_by_control,
    arc_by_state,
    velocity,
    velocity_by_control,
    velocity_by_state,
)
from models.motion.gyro import (
    drifting,
    drifting_by_bias,
    drifting_by_control,
    drifting_by_state,
)
from models.motion.relative import (
    place,
    place_by_sight,
    place_by_state,
    relative,
    relative_by_other,
    relative_by_state,
    retreat,
    retreat_by_control,
    retreat_by_state,
)
from models.motion.steps import (
    increment,
    increment_by_control,
    increment_by_state,
    odometry,
    odometry_by_control,
    odometry_by_state,
    travelled,
    travelled_by_control,
    travelled_by_state,
    turn_after_move,
    turn_after_move_by_control,
    turn_after_move_by_state,
)
from models.motion.wheels import DifferentialDrive

__all__ = [
    "DifferentialDrive",
    "Velocity",
    "arc",
    "arc_by_control",
    "arc_by_state",
    "drifting",
    "drifting_by_bias",
    "drifting_by_control",
    "drifting_by_state",
    "increment",
    "increment_by_control",
    "increment_by_state",
    "odometry",
    "odometry_by_control",
    "odometry_by_state",
    "place",
    "place_by_sight",
    "place_by_state",
    "relative",
    "relative_by_other",
    "relative_by_state",
    "retreat",
    "retreat_by_control",
    "retreat_by_state",
    "travelled",
    "travelled_by_control",
    "travelled_by_state",
    "turn_after_move",
    "turn_after_move_by_control",
    "turn_after_move_by_state",
    "velocity",
    "velocity_by_control",
    "velocity_by_state",
]
