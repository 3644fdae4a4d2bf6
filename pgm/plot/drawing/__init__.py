"""Drawing for all pictures: axes, colours, and the components of a belief to draw."""
