"""Work handed to an executor: to threads, processes, or machines."""

from pgm.inference.executors.parcels import Shape, address
from pgm.inference.executors.workers import Workers

__all__ = ["Shape", "Workers", "address"]
