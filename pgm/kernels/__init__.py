"""Array-only mathematics: pure functions on stacks of small matrices, leading axes throughout."""
