"""What all pictures draw with: axes, colours, and the components of a belief to draw."""
