r"""Walk-summability of a Gaussian network: whether messages round its loops may diverge.

The information matrix J of the hidden components, given the evidence, and its diagonal D give the
partial correlations

.. math:: R = I - D^{-1/2} J D^{-1/2}.

Means and variances are sums over walks on the graph of R, and messages add these up. Where the
spectral radius of \|R\| is below one the sums converge absolutely, in whatever order messages are
sent; where it is not they may diverge (Malioutov, Johnson & Willsky, Walk-sums and belief
propagation in Gaussian graphical models, 2006).
"""

from __future__ import annotations

import numpy as np

from pgm.beliefs.gaussian.messages import RowMessages

# Components up to which the radius is computed: a dense matrix, and less than a second.
MOST = 1000


def shown(radius: float) -> str:
    """A spectral radius as text, with four digits if it is below 1, else with three.

    A radius that these digits would show as "1" is shown by its distance from 1, as "1 − 2e-06".
    """
    text = f"{radius:.4g}" if radius < 1.0 else f"{radius:.3g}"
    if text != "1" or radius == 1.0:
        return text
    return f"1 {'+' if radius > 1.0 else '−'} {abs(radius - 1.0):.1g}"


def spectral_radius(messages: RowMessages, run: int) -> float | None:
    """The spectral radius of |R| in one run, by its number; walk-summable if below 1.

    None if there are more than 1000 components, or if J or R does not exist, as with CPDs without
    noise.
    """
    layout = messages.buffer.rounds.layout
    if layout.size > MOST:
        return None
    information = np.zeros((layout.size, layout.size))
    for cluster, scope in enumerate(layout.scopes):
        factor, _ = messages.potential(cluster)
        if factor.exact is not None and factor.exact.any():
            return None
        rows = factor.matrix[min(run, len(factor.matrix) - 1)]
        places = layout.components(scope)
        information[np.ix_(places, places)] += rows.T @ rows
    scale = np.sqrt(np.diagonal(information))
    with np.errstate(all="ignore"):  # what is not finite is refused
        partial = np.abs(information / scale[:, None] / scale)
    if not partial.size or not np.isfinite(partial).all():
        return None
    np.fill_diagonal(partial, 0.0)
    return float(np.linalg.eigvalsh(partial)[-1])
