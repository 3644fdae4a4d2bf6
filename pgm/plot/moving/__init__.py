"""Moving pictures: how they are written, and the run of a filter and a smoother."""
