"""Maps: occupancy grids, landmarks, and the sensors that are read against them."""

from pgm.maps.cells import Cells
from pgm.maps.landmarks import FeatureMap
from pgm.maps.log_odds import log_odds_map
from pgm.maps.occupancy import OccupancyMap
from pgm.maps.scan_models import BeamModel, LikelihoodField
from pgm.maps.uniform import UniformPose

__all__ = [
    "BeamModel",
    "Cells",
    "FeatureMap",
    "LikelihoodField",
    "OccupancyMap",
    "UniformPose",
    "log_odds_map",
]
