"""The filter of a running robot: the forward half of a chain, one step at a time.

An `OnlineFilter` predicts a belief from the one before, and updates it with measurements. With a
lag it also smooths the steps just behind.
"""
