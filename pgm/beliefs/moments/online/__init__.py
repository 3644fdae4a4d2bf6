"""Gaussian beliefs in a robot's loop: the forward half of a chain, one step at a time.

`MomentSteps` predicts a belief from the one before, and updates it with measurements. With a lag it
also smooths the steps just behind.
"""
