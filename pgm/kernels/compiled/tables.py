"""Tables of integers by which kernels know chains and CPDs: where each number stands.

A CPD is a row of its table: its sizes, the addresses of its functions, and where its numbers are.
A chain is a row too: its shape, the addresses of its tables of CPDs, and its arrays. An array
(rows, runs, ...) of a CPD, or (steps, runs, ...) of a chain, takes four places: its address, and
how many floats lie between rows, between runs, and between components; address 0 is that of none.
"""

# Of a CPD.
(KIND, SIZE, HEIGHT, PARENTS, WHOLE, CHILD, FUNCTION, VALUE, TURNING, TURNS) = range(10)
(ANGLES, BARE, UNSURE, POINTS, COUNT, CENTRED, LEAST, STEPS, SHARP) = range(10, 19)
(INPUTS, MATRIX, OFFSET, NOISE, KEPT_NOISE, READINGS, MOVED) = range(20, 48, 4)
COLUMNS = 48
# How a CPD is linearised: it is affine, or was before; at its mean; on points.
AFFINE, TAYLOR, REGRESSION = range(3)

# Of a chain, its shape: T, whether one CPD makes all of a slice of all of the one before, and the
# components of states and of a slice.
(LAST, SINGLE, FRONT, WIDTH, LINKS, LINK_COUNT, SENSORS, SENSOR_COUNT, STATES) = range(9)
# Linearisations of a step's measurements, where their settings are, (tolerance, damping), and their
# record, (iterations + 1, runs): the residuals of each, how many, and whether some did not settle.
(ITERATIONS, SETTINGS, RESIDUALS) = range(9, 12)
# The least share of a variance that is left open, variances to grow from, and whether a mean is far
# from zero, by run; how runs ended.
(CLOSEST, STATUS, RUN_COUNT) = range(12, 15)
# The belief that a sweep starts with, and its record.
(BEGIN_MEAN, BEGIN_COV, PREDICTED_MEAN, PREDICTED_COV, MEAN, COV, DENSITY) = range(16, 44, 4)
# The reversed chain, its transition, and the smoothed beliefs.
(STEP_MATRIX, STEP_NOISE, GAIN, SHIFT, REST, LATER_MEAN, LATER_COV) = range(44, 72, 4)
(CONTROL_GAIN, CONTROL_SHIFT, CONTROL_REST) = range(72, 84, 4)
FIELDS = 84

# How a run ended: done, or to be done by the general kernels.
DONE, LEFT = 0, 1
# Packs are of so many runs, or of so many floats of a row.
RUNS, ROW = 8, 4
