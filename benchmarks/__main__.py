"""`python -m benchmarks`: see `make bench`."""

from benchmarks.machine import one_core

if __name__ == "__main__":
    one_core()  # before NumPy or JAX start their threads
    from benchmarks.command import main

    main()
