"""Grids: beliefs of dynamic networks as probabilities of cells.

The user gives each component of the states an interval, or a circle, and a number of cells. Filters
and smoothers then move probabilities from cell to cell by the transition, and weigh them by the
densities of measurements at the centres of the cells.
"""
