"""Networks: CPDs that declare a joint density."""

from pgm.networks.dynamic import DynamicBayesianNetwork
from pgm.networks.sampling import Sample
from pgm.networks.static import BayesianNetwork

__all__ = ["BayesianNetwork", "DynamicBayesianNetwork", "Sample"]
