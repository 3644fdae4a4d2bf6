"""Declared networks, and the motion and sensor functions they are made of."""
