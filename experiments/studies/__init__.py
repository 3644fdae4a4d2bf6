"""Studies that outgrow a machine: a grid of settings, cut into parts that Dask carries."""

from experiments.studies.errors import StudyError
from experiments.studies.study import Study

__all__ = ["Study", "StudyError"]
