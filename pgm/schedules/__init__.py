"""Schedules: which messages are sent, how often CPDs are linearised, and the options of a call.

A sweep carries any family of beliefs along a chain; rounds go over graphs of any shape; iterations
linearise again, damped, until nothing moves.
"""
