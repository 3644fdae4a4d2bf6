"""The engine of dynamic networks: chains of slices, stacked along the axis of time."""
