"""The variables that the networks share: metres, radians, seconds."""

import pgm

# A pose; the heading is anticlockwise from east.
pose = pgm.Variable("x", components=("east", "north", "heading"), angles=("heading",))
# A commanded velocity [m/s, rad/s], and motion since the step before [m, rad, s].
velocity = pgm.Variable("u", components=("v", "omega"))
travelled = pgm.Variable("u", components=("distance", "turn", "dt"))
# A velocity that holds for a duration [m/s, rad/s, s], and a duration alone [s].
timed_velocity = pgm.Variable("u", components=("v", "omega", "dt"))
clock = pgm.Variable("dt", components=("dt",))
# Wheel speeds [rad/s], and a move that is followed by a turn [m, rad].
wheels = pgm.Variable("u", components=("left", "right"))
move = pgm.Variable("u", components=("distance", "turn"))
# Odometry that turns, goes straight and turns again [rad, m, rad].
odometry = pgm.Variable("u", components=("rot1", "trans", "rot2"))
# A landmark at a known place [m], and readings of it [m, rad].
landmark = pgm.Variable("m", components=("east", "north"))
distance = pgm.Variable("z", components=("range",))
bearing = pgm.Variable("z", components=("bearing",), angles=("bearing",))
sighting = pgm.Variable("z", components=("range", "bearing"), angles=("bearing",))
# A point that moves in the plane, its displacement [m] or velocity [m/s].
point = pgm.Variable("x", components=("east", "north"))
shift = pgm.Variable("u", components=("east", "north"))
speed = pgm.Variable("u", components=("v_east", "v_north"))
# Readings of a position [m], of a pose, and of a heading alone.
fix = pgm.Variable("z", components=("east", "north"))
pose_fix = pgm.Variable("z", components=("east", "north", "heading"), angles=("heading",))
compass = pgm.Variable("z", components=("heading",), angles=("heading",))
# How a sensor is off: range = scale · distance + offset [1, m]; where it is mounted on the robot
# [m, m, rad]; by how much a gyro tells too much [rad/s].
calibration = pgm.Variable("c", components=("scale", "offset"))
mount = pgm.Variable("a", components=("forward", "left", "turn"), angles=("turn",))
gyro_bias = pgm.Variable("b", components=("rate",))
# A target with its velocity [m, m/s], and one that turns, too [rad/s].
target = pgm.Variable("x", components=("east", "north", "v_east", "v_north"))
turning_target = pgm.Variable("x", components=("east", "north", "v_east", "v_north", "omega"))
