"""The experiments by name; each module or package has `run`, and `QUICK`, its quick settings."""

import inspect
from types import ModuleType

from experiments import (
    basics,
    belief_propagation,
    cluster_graph,
    differential_drive,
    freiburg,
    global_localisation,
    grid_localisation,
    grid_world,
    hallway,
    imu_heading,
    iterated,
    kalman,
    kidnapped,
    killian,
    linearisers,
    localisation,
    maze,
    nonlinear_measurement,
    particle_counts,
    plaza,
    seven_nodes,
    smoothing,
    topological,
)

# In the order in which a newcomer would run them.
EXPERIMENTS: dict[str, ModuleType] = {
    "localisation": localisation,
    "plaza": plaza,
    "freiburg": freiburg,
    "killian": killian,
    "basics": basics,
    "kalman": kalman,
    "cluster_graph": cluster_graph,
    "linearisers": linearisers,
    "nonlinear_measurement": nonlinear_measurement,
    "iterated": iterated,
    "smoothing": smoothing,
    "imu_heading": imu_heading,
    "differential_drive": differential_drive,
    "particle_counts": particle_counts,
    "seven_nodes": seven_nodes,
    "belief_propagation": belief_propagation,
    "grid_world": grid_world,
    "hallway": hallway,
    "maze": maze,
    "topological": topological,
    "grid_localisation": grid_localisation,
    "global_localisation": global_localisation,
    "kidnapped": kidnapped,
}


def summary_line(experiment: ModuleType) -> str:
    """The first line of an experiment's docstring, without its full stop."""
    return (inspect.getdoc(experiment.run) or "").partition("\n")[0].removesuffix(".")
