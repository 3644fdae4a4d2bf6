"""Maps that grow: a tree of cliques of which an addition touches a part, as of ISAM2.

Source: Kaess, Johannsson, Roberts, Ila, Leonard, Dellaert (2012), iSAM2: Incremental smoothing and
mapping using the Bayes tree. A *clique* eliminates its *pivots*, variables that no clique above it
holds, given its *separators*, which its parent holds too. What it leaves to its parent are rows
over its separators. What is added touches the cliques of its variables and all cliques above them;
others keep their triangles, and what they left.
"""

from pgm.inference.growing.association import Association
from pgm.inference.growing.clique_tree import CliqueTree
from pgm.inference.growing.growing_map import GrowingMap
from pgm.inference.growing.growth import Growth

__all__ = ["Association", "CliqueTree", "GrowingMap", "Growth"]
