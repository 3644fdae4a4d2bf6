"""Speed against other libraries: the same work, in one run, on one thread of one core."""
