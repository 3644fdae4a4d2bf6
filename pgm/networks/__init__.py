"""Networks: CPDs that declare a joint density."""

from pgm.networks.dynamic import DynamicBayesianNetwork
from pgm.networks.sampling import Sample

__all__ = ["DynamicBayesianNetwork", "Sample"]
