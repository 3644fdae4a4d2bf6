"""Point masses: what cells and weighted draws have in common.

Beliefs by point masses and their filters in a robot's loop; clouds of particles; CPDs that draw
points, and whose densities are evaluated at them.
"""
