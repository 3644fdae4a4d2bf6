"""Networks of discrete and continuous variables: a Gaussian network for each configuration.

Given its discrete variables, a mixed network is a Gaussian one: of CPDs, in whose terms factors
without direction are put, too (`split`). Where evidence cuts it, it falls into parts; the
configurations of the discrete variables that choose in a part are runs of one Gaussian tree
(`parts`, `configurations`, `weighing`), and the log-evidence of each is a factor of the network of
tables (`run`). A marginal is then a mixture over configurations (`outcome`). It is what a strong
junction tree computes (Lauritzen, 1992).
"""

from pgm.beliefs.mixed.family import MIXED

__all__ = ["MIXED"]
