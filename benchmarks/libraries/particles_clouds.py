"""The package particles: its bootstrap filter, with the same functions of motion and sensor."""

from __future__ import annotations

from typing import Any

import numpy as np
import particles
from particles import distributions as dists
from particles import state_space_models as ssm

from benchmarks.timing import Contender
from benchmarks.work import clouds, robots
from benchmarks.work.clouds import Clouds
from benchmarks.work.robots import Array
from models import sensors


def filtering(functions: str, work: Clouds) -> Contender:
    """The mean and covariance at the last step."""
    drive = clouds.plain_drive if functions == "plain" else robots.DRIVE
    sees = clouds.plain_range_bearing if functions == "plain" else sensors.range_bearing
    drive_of, run = drive, work.robots
    controls, marks = run.controls, run.landmarks[:, 0]
    start, motion, sensor = clouds.START_STD, clouds.MOTION_STD, clouds.SENSOR_STD

    class Drive(ssm.StateSpaceModel):  # type: ignore[misc]
        def PX0(self) -> Any:
            return dists.IndepProd(*(dists.Normal(0.0, each) for each in start))

        def PX(self, t: int, xp: Array) -> Any:
            mean = drive_of(xp, np.broadcast_to(controls[t - 1], (len(xp), 2)))
            each = zip(mean.T, motion, strict=True)
            return dists.IndepProd(*(dists.Normal(loc, std) for loc, std in each))

        def PY(self, t: int, xp: Array, x: Array) -> Any:
            if t == 0:
                return dists.IndepProd(*(dists.FlatNormal(loc=np.zeros(len(x))),) * 2)
            mean = sees(x, np.broadcast_to(marks[t - 1], (len(x), 2)))
            each = zip(mean.T, sensor, strict=True)
            return dists.IndepProd(*(dists.Normal(loc, std) for loc, std in each))

    data = np.concatenate([np.zeros((1, 2)), run.readings[0, :, 0]])[:, None]

    def call() -> tuple[Array, Array]:
        model = ssm.Bootstrap(ssm=Drive(), data=list(data))
        filtered = particles.SMC(fk=model, N=work.count, resampling="systematic", ESSrmin=0.5)
        filtered.run()
        weights, states = filtered.W, filtered.X
        mean = weights @ states
        apart = states - mean
        return mean, np.einsum("i,ij,ik->jk", weights, apart, apart)

    return Contender(call, work.units)
