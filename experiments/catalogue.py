"""The experiments by name and theme; each has `run`, and `QUICK`, its quick settings."""

import inspect
from collections.abc import Iterator
from types import ModuleType

from experiments import (
    basics,
    belief_propagation,
    calibration,
    cluster_graph,
    comparison_at_scale,
    differential_drive,
    freiburg,
    global_localisation,
    grid_localisation,
    grid_world,
    hallway,
    height_and_group,
    imu_heading,
    incinerator,
    iterated,
    kalman,
    kidnapped,
    killian,
    learning,
    linearisers,
    localisation,
    manoeuvre,
    maze,
    mirror,
    nonlinear_measurement,
    outlier_cause,
    particle_counts,
    plaza,
    pose_graphs,
    recordings,
    seven_nodes,
    slam,
    smoothing,
    topological,
    two_targets,
    unknown_landmarks,
    wide_start,
)

# Themes, and within them experiments, in the order in which a newcomer would read them.
THEMES: dict[str, dict[str, ModuleType]] = {
    "Filters and smoothers": {
        "localisation": localisation,
        "smoothing": smoothing,
        "iterated": iterated,
        "kalman": kalman,
        "imu_heading": imu_heading,
        "differential_drive": differential_drive,
    },
    "Linearisers": {
        "linearisers": linearisers,
        "nonlinear_measurement": nonlinear_measurement,
        "comparison_at_scale": comparison_at_scale,
        "learning": learning,
    },
    "Maps": {
        "slam": slam,
        "pose_graphs": pose_graphs,
    },
    "Recorded robots": {
        "recordings": recordings,
        "wide_start": wide_start,
        "plaza": plaza,
        "calibration": calibration,
        "freiburg": freiburg,
        "killian": killian,
    },
    "Particles and grids, for robots that may be anywhere": {
        "particle_counts": particle_counts,
        "grid_localisation": grid_localisation,
        "global_localisation": global_localisation,
        "kidnapped": kidnapped,
    },
    "Modes and identities that no one has named": {
        "height_and_group": height_and_group,
        "incinerator": incinerator,
        "manoeuvre": manoeuvre,
        "outlier_cause": outlier_cause,
        "two_targets": two_targets,
        "unknown_landmarks": unknown_landmarks,
        "mirror": mirror,
    },
    "Graphs and messages": {
        "basics": basics,
        "cluster_graph": cluster_graph,
        "seven_nodes": seven_nodes,
        "belief_propagation": belief_propagation,
    },
    "Discrete robots": {
        "grid_world": grid_world,
        "hallway": hallway,
        "maze": maze,
        "topological": topological,
    },
}
EXPERIMENTS: dict[str, ModuleType] = {
    name: experiment for group in THEMES.values() for name, experiment in group.items()
}
# Recordings and maps that an experiment cannot run without, and where they come from.
NEEDS = {
    "recordings": "recordings: pip install gtsam, or --path, or PGM_DATA",
    "wide_start": "recordings: pip install gtsam, or PGM_DATA",
    "plaza": "recordings: pip install gtsam",
    "calibration": "recordings: pip install gtsam",
    "freiburg": "a recording: --path, or PGM_DATA",
    "unknown_landmarks": "a recording: --path, or PGM_DATA",
    "killian": "a recording: pip install 'rtb-data>=2.0'; or --data made_up",
    "global_localisation": "a floor plan: pip install 'rtb-data>=2.0'",
    "kidnapped": "a floor plan: pip install 'rtb-data>=2.0'",
}


def listing() -> Iterator[str]:
    """The experiments by theme, a line each, and what those need that cannot run without data."""
    width = max(map(len, EXPERIMENTS))
    for theme, group in THEMES.items():
        yield f"{theme}:"
        for name, experiment in group.items():
            needs = f" [{NEEDS[name]}]" if name in NEEDS else ""
            yield f"  {name:<{width}}  {summary_line(experiment)}{needs}"


def summary_line(experiment: ModuleType) -> str:
    """The first line of an experiment's docstring, without its full stop."""
    return (inspect.getdoc(experiment.run) or "").partition("\n")[0].removesuffix(".")
