"""Results of a chain with Gaussian beliefs: outcomes, marginals, innovations, families."""
