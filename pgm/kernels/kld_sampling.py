"""The number of draws that represents a distribution over bins, by KLD-sampling.

For n draws from k bins the statistic S = 2 n KL(empirical ‖ true) has, where bins have many draws
each, a χ² distribution of k − 1 degrees of freedom (Wilks, 1938): with n = χ²_{k−1, 1−δ} / (2 ε)
draws the divergence is at most ε with probability 1 − δ (Fox, Adapting the sample size in particle
filters through KLD-sampling, 2003). Where bins have a few draws each, S is larger: a Poisson count
X about λ adds 2 (X ln(X / λ) − X + λ), whose mean and variance, 1 and 2 for large λ, are at most
1.1605 and 2.406, at λ of 1.3 and 3. The quantile taken here is that of a gamma distribution with
(k − 1) times these, so that the probability holds for any distribution over the bins.
"""

from __future__ import annotations

import math

# Largest mean and variance of a bin's part of the statistic, over all expected counts.
_MEAN, _VARIANCE = 1.1605, 2.406


def draws_needed(bins: int, epsilon: float, delta: float) -> int:
    """The number n of draws that represents a distribution over so many `bins`; 1 for one bin.

    `bins` counts the bins that draws have occupied. With n draws, KL(empirical ‖ true) is at most
    `epsilon` nats with probability 1 − `delta`.
    """
    if bins <= 1:
        return 1
    # Here, since it is half of the time that importing pgm takes.
    from scipy.special import gammainccinv

    scale = _VARIANCE / _MEAN
    quantile = scale * float(gammainccinv((bins - 1) * _MEAN / scale, delta))
    return math.ceil(quantile / (2.0 * epsilon))
