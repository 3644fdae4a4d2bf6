r"""Angles of which a density knows no turns: each turn's share of what is the same for all.

A density of an angle that wrapped residuals alone tell of is the same a whole turn away. It has an
integral over one turn, not over the line; draws are on the line. So the density is multiplied by
shares ω that add up to one over turns,

.. math:: \omega(x) = s(x) / \sum_j s(x + 2πj), \qquad s(x) = \sum_k N(x; c_k, w_k^2),

with the centres c_k and widths w_k of the modes that draws are from: near each of them almost all
is given to its own turn. The integral over the line is then that over a turn. Of several such
angles the shares are multiplied.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pgm.kernels.angles import wrap
from pgm.kernels.arrays import Array, Integers

# Widths are within these bounds, so that two turns on either side are all that count.
LEAST, MOST = 1e-3, 0.5 * math.pi
TURNS = range(-2, 3)


@dataclass(frozen=True, eq=False)
class Turns:
    """Angles without turns, and about where draws are.

    places : ndarray
        (m,): the places of the angles among all components.
    centres, widths : ndarray
        (K, runs, m): of K modes the means and standard deviations.
    """

    places: Integers
    centres: Array
    widths: Array

    def log_share(self, values: Array) -> Array:
        """The logarithm of all angles' shares, (runs, S), at values (runs, S, n)."""
        angles = values[..., self.places]
        own = np.full(angles.shape, -np.inf)
        every = own.copy()
        widths = np.clip(self.widths, LEAST, MOST)
        for centre, width in zip(self.centres[:, :, None], widths[:, :, None], strict=True):
            off = angles - centre
            own = np.logaddexp(own, -0.5 * (off / width) ** 2 - np.log(width))
            near = wrap(off)
            for turn in TURNS:
                away = (near + 2.0 * math.pi * turn) / width
                every = np.logaddexp(every, -0.5 * away**2 - np.log(width))
        total: Array = (own - every).sum(axis=-1)
        return total
