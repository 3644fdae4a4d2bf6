"""Single queries: the joint of a few variables, from the part of a network that bears on it."""

from pgm.inference.query.question import query

__all__ = ["query"]
