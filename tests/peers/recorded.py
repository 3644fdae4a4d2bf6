"""A plug-in for pytest that writes each linear model which a test filters into a folder.

Used as ``PEERS_RECORDS=folder pytest -p peers.recorded --pyargs statsmodels...``.
"""

import hashlib
import os
from pathlib import Path

import numpy as np
from statsmodels.tsa.statespace.initialization import Initialization
from statsmodels.tsa.statespace.kalman_filter import FilterResults
from statsmodels.tsa.statespace.kalman_smoother import KalmanSmoother

FOLDER = os.environ.get("PEERS_RECORDS", "")
MATRICES = (
    "design", "obs_intercept", "obs_cov", "transition", "state_intercept", "selection", "state_cov",
)  # fmt: skip
update = FilterResults.update_filter


def record(results, engine):
    update(results, engine)
    names = (*MATRICES, "endog", "initial_state", "initial_state_cov", "filter_timing")
    arrays = {name: np.asarray(getattr(results, name)) for name in names}
    arrays["diffuse"] = np.asarray(engine.model.initial_diffuse_state_cov)
    if any(array.dtype.kind == "c" for array in arrays.values()):
        return  # derivatives by complex steps
    content = hashlib.sha1(b"".join(array.tobytes() for array in arrays.values())).hexdigest()
    np.savez(Path(FOLDER) / f"{content}.npz", **arrays)


if FOLDER:
    FilterResults.update_filter = record


def replayed(path, count=None):
    """The model of a file, with all or the first of its observations."""
    with np.load(path) as file:
        arrays = dict(file)
    rows = arrays["endog"].astype(float)[:, :count]
    diffuse, mean, cov = (arrays[k] for k in ("diffuse", "initial_state", "initial_state_cov"))
    ssm = KalmanSmoother(len(rows), mean.size, arrays["selection"].shape[1])
    ssm.bind(np.ascontiguousarray(rows.T))
    for name in MATRICES:
        value = arrays[name]
        ssm[name] = value[..., 0] if value.shape[-1] == 1 else value[..., : rows.shape[1]]
    ssm.timing_init_filtered = bool(arrays["filter_timing"])
    if diffuse.any():
        start = Initialization(mean.size)
        for i, part in enumerate(np.diagonal(diffuse)):
            if part:
                start.set(i, "diffuse")
            else:
                start.set(i, "known", constant=mean[i : i + 1], stationary_cov=cov[[i]][:, [i]])
        ssm.initialization = start
    else:
        ssm.initialize_known(mean, cov)
    return ssm
