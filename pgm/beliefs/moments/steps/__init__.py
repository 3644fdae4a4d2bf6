"""One step of a chain with Gaussian beliefs: its plan, its prediction, its measurements."""
