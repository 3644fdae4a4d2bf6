"""CPDs and chains as they were linearised last."""

from __future__ import annotations

from dataclasses import replace
from typing import TypeVar

from pgm.kernels.machine.sweeps.told.chains import Forward
from pgm.kernels.machine.sweeps.told.rows import Motion, Row
from pgm.kernels.machine.sweeps.told.sensors import Sensor

Kind = TypeVar("Kind", bound=Row)


def as_kept(chain: Forward) -> Forward:
    """A chain as its CPDs were linearised, and sightings weighed, last."""
    motions = tuple(map(kept_motion, chain.motions))
    sensors = tuple(kept_sensor(sensor, weighed=True) for sensor in chain.sensors)
    return replace(chain, motions=motions, sensors=sensors)


def kept_motion(motion: Motion) -> Motion:
    """A CPD of a transition as it was linearised last."""
    return replace(_affine(motion), noise=motion.kept or motion.noise, turning=())


def kept_sensor(sensor: Sensor, *, weighed: bool) -> Sensor:
    """A sensor as it was linearised last; its noise is `weighed`, or still to be."""
    noise, loss = sensor.noise, sensor.loss
    if sensor.kept is not None and (weighed or loss is None):
        noise = sensor.kept
    return replace(
        _affine(sensor),
        noise=noise,
        readings=sensor.moved or sensor.readings,
        moved=None,
        loss=None if loss is None else replace(loss, found=weighed),
    )


def chosen(sensor: Sensor) -> Sensor:
    """A sensor as its sightings are read with the candidate that was chosen last."""
    of = sensor.candidates
    assert of is not None
    return replace(
        _affine(sensor),
        matrix=of.matrix,
        offset=of.offset,
        noise=of.noise,
        inputs=(),
        shifts=(),
        angles=sensor.angles,
        readings=of.values or sensor.readings,
        missing=sensor.missing or of.values is not None,
        candidates=None,
    )


def _affine(row: Kind) -> Kind:
    """A CPD as it was linearised last, but for its noise."""
    inputs = () if row.curved else row.inputs
    affine = replace(row, function=None, called=None, points=None, inputs=inputs)
    return replace(affine, kept=None, angles=())
