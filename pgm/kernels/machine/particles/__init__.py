"""Particles in machine code: moved, weighed and drawn anew, block by block in threads."""
