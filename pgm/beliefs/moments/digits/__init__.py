"""The digits that float64 leaves of a chain's beliefs, and passes with twice as many."""
