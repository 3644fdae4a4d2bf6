"""The number of draws that represents a distribution over bins, by KLD-sampling.

The statistic S = 2 n KL(empirical ‖ true) tells how far the shares of n draws in k bins are from
the bins' probabilities. Let q be the quantile that S is below with probability 1 − δ: with
n = q / (2 ε) draws the divergence is then at most ε with this probability (Fox, Adapting the sample
size in particle filters through KLD-sampling, 2003). If each bin has many draws, S has a χ²
distribution of k − 1 degrees of freedom (Wilks, 1938), of mean k − 1 and variance 2 (k − 1).

If bins have few draws, S is larger. Let the number X of draws in a bin have a Poisson distribution
of mean λ; the bin then adds 2 (X ln(X / λ) − X + λ) to S. This summand has the mean 1 and the
variance 2 for large λ. Over all λ its mean is at most 1.1605, at λ = 1.3, and its variance at most
2.406, at λ = 3. Here q is the quantile of a gamma distribution whose mean and variance are k − 1
times these two, so that the probability holds for any distribution over the bins.
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
