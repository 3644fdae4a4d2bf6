"""hmmlearn's categorical model, whose sweeps are C, with scales in place of logarithms."""

from __future__ import annotations

import numpy as np
from hmmlearn.hmm import CategoricalHMM

from benchmarks.timing import Contender
from benchmarks.work.chains import Array, Chains


def smoothing(work: Chains) -> Contender:
    """One run: (T, states)."""
    first, motion, sensor = work.tables
    model = CategoricalHMM(n_components=len(first), implementation="scaling")
    model.startprob_, model.transmat_, model.emissionprob_ = first, motion, sensor
    model.n_features = sensor.shape[1]

    def call() -> Array:
        return np.asarray(model.predict_proba(work.readings[0][:, None]))

    return Contender(call, work.steps)
