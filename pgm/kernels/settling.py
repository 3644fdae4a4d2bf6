"""When iterations have settled, in NumPy and in machine code alike."""

# Weights of robust noise are found anew so often at most, until none moves by more than this.
REWEIGHINGS, SETTLED = 200, 1e-10
# Standard deviations by which a mean may still move at what counts as a fixed point: nothing that
# an estimate could show, and within reach of float64 and of ten linearisations of most recordings.
# So far may weights move, too, that count as found.
TOLERANCE = 1e-6
