"""Pictures of beliefs: in the plane, over cells, and over time."""
