"""Linearisation: a CPD at all its rows, with its evidence, its noise and its slope at beliefs."""
