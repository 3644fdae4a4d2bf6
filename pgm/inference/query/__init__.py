"""Single queries: the joint of a few variables, from the part of a network that it depends on."""

from pgm.inference.query.question import query

__all__ = ["query"]
