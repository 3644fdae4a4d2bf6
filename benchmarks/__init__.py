"""Speed against other libraries, on the same work, as ratios measured in one run."""
