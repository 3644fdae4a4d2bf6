"""The work that every library is given."""
