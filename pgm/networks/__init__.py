"""Networks: factors, or CPDs, that declare a joint density."""

from pgm.networks.dynamic import DynamicBayesianNetwork
from pgm.networks.markov import MarkovNetwork
from pgm.networks.sampling import Sample
from pgm.networks.static import BayesianNetwork

__all__ = ["BayesianNetwork", "DynamicBayesianNetwork", "MarkovNetwork", "Sample"]
