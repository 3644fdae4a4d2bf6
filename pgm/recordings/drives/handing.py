"""Streams of a recording, handed to `pgm.timeline` under a network's variables."""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from pgm.boundary import as_mapping
from pgm.display import count
from pgm.errors import EvidenceError
from pgm.factors.scope import listed
from pgm.io.controls import DT
from pgm.io.stamped import SAME, Stamped, rows_text, stamped
from pgm.io.timeline import Timeline
from pgm.io.timeline import timeline as lay
from pgm.io.tum import JOINED
from pgm.kernels.arrays import Array, Mask
from pgm.recordings.drives import motion, quantities, spreads
from pgm.recordings.drives.stream import Stream
from pgm.variables import Variable

if TYPE_CHECKING:
    from pgm.recordings.drives.recording import Recording

# A smaller correlation moves a mean by less than a hundredth of a deviation; where a plane's axes
# are turned from those of a fix, such are made.
_UNCORRELATED = 0.01


def timeline(
    recording: Recording,
    times: Array,
    *,
    odometry: Variable | None,
    velocities: Variable | None,
    sensors: Mapping[Variable, str],
    landmark: Variable | None,
    variances: Mapping[Variable, Variable],
    tolerance: float | None,
) -> Timeline:
    """The evidence of states at given times."""
    seen = {}
    named = {v: sensor(recording, name) for v, name in sensors.items()}
    if landmark is not None and not any(each.subject is not None for each in named.values()):
        raise EvidenceError(
            "nothing says whose the sightings are; leave landmark= out, and give "
            f"{landmark!r} as pgm.unknown(candidates)",
            variable=landmark,
        )
    for variable, stream in named.items():
        given = {}
        if landmark is not None and stream.subject is not None:
            given[landmark] = places(recording, sensors[variable], stream, landmark)
        if variable in variances:
            parent = variances[variable]
            given[parent] = spread(sensors[variable], stream, variable, parent)
        seen[variable] = stamped(stream.stamps, columns(variable, stream), given)
    driven: dict[Variable, Stamped] = {}
    held: dict[Variable, Stamped] = {}
    if odometry is not None:
        require_variable(odometry, "odometry=")
        if tuple(name for name in odometry.components if name != DT) == motion.PLANAR:
            exact = recording.resampled(times).odometry
            assert exact is not None
            driven[odometry] = _since(exact, columns(odometry, exact), times)
        else:
            driven[odometry] = _increments(recording, odometry, times)
    if velocities is not None:
        require_variable(velocities, "velocities=")
        if recording.velocities is None:
            raise EvidenceError(f"{recording._title} has no velocities", variable=velocities)
        stream = recording.velocities
        held[velocities] = stamped(stream.stamps, columns(velocities, stream))
    return lay(times, odometry=driven, velocities=held, sensors=seen, tolerance=tolerance)


def _increments(recording: Recording, variable: Variable, times: Array) -> Stamped:
    stream = recording.odometry
    if stream is None:
        raise EvidenceError(
            f"{recording._title} has no odometry; name velocities=, or let {variable!r} have the "
            f"components ({listed(motion.PLANAR)})",
            variable=variable,
        )
    return _since(stream, columns(variable, stream), times)


def _since(stream: Stream, table: Array, times: Array) -> Stamped:
    """Increments, the first of which counts from the stream's beginning on."""
    begin, stamps = stream.begin, stream.stamps
    if not len(stream):
        raise EvidenceError("the odometry has no rows")
    if begin is None:
        table = np.concatenate([np.zeros_like(table[:1]), table[1:]])
    elif (
        begin < times[0] - SAME
        or stamps[0] - begin > np.diff(stamps).max(initial=0.0)
        or times[0] < begin - SAME
    ):
        # A row of zeros says where it begins; else `timeline` takes it to, and says so.
        table = np.concatenate([np.zeros_like(table[:1]), table])
        stamps = np.append(begin, stamps)
    return stamped(stamps, table)


def sensor(recording: Recording, name: str) -> Stream:
    """The sightings of a sensor; or the fixes, or the inertial readings."""
    known = dict(recording.sightings)
    for part, stream in (("fixes", recording.fixes), ("imu", recording.imu)):
        if stream is not None:
            known.setdefault(part, stream)
    if name not in known:
        raise EvidenceError(f"{recording._title} has no sensor {name!r}; it has {listed(known)}")
    return known[name]


def spread(name: str, stream: Stream, reading: Variable, variable: Variable) -> Array:
    """The variances of a sensor's readings, of a variable's components by name, (M, d).

    A component that is called like a product, ``east*north``, is a covariance. They are in the
    squares and products of the units of the readings' variable.
    """
    if stream.cov is None:
        raise EvidenceError(
            f"the sensor {name!r} has no variances that {variable!r} could be; leave it out of "
            "variances=, or give the stream some, stream.replace(variances=...)",
            variable=variable,
        )
    pairs = [_pair(variable, stream, component) for component in variable.components]
    _require_correlations(name, stream, variable, pairs)
    sizes = [
        _size(reading, stream, each) if each in reading.components else 1.0
        for each in stream.components
    ]
    found = np.column_stack([stream.cov[:, j, k] * (sizes[j] * sizes[k]) for j, k in pairs])
    lost = np.flatnonzero(np.isnan(found).any(axis=1) & ~np.isnan(stream.values).all(axis=1))
    if lost.size:
        raise EvidenceError(
            f"the sensor {name!r} has no variances in {count(lost.size, 'row')} "
            f"({rows_text(lost)}); leave these rows out, or say how sure they are",
            variable=variable,
        )
    return found


def _pair(variable: Variable, stream: Stream, component: str) -> tuple[int, int]:
    """The two components of a stream that a component of a variable is the covariance of."""
    names = [component, component] if component in stream.components else component.split(JOINED)
    if len(names) != 2 or not set(names) <= set(stream.components):
        raise EvidenceError(
            f"{variable!r} has the component {component!r}, and the stream "
            f"{listed(stream.components)}; they go by name, a variance by its component's and a "
            f"covariance by two, {JOINED.join(stream.components[:2])!r}",
            variable=variable,
        )
    one, other = sorted(map(stream.place, names))
    return one, other


def _require_correlations(
    name: str, stream: Stream, variable: Variable, pairs: Sequence[tuple[int, int]]
) -> None:
    """Refuse variances of readings that are correlated, unless the covariances are asked for."""
    assert stream.cov is not None
    alone = [j for j, k in pairs if j == k]
    for j, k in combinations(sorted(alone), 2):
        size = spreads.correlation(stream.cov, j, k)
        if (j, k) not in pairs and (size > _UNCORRELATED).any():
            rows = np.flatnonzero(size > _UNCORRELATED)
            one, other = stream.components[j], stream.components[k]
            raise EvidenceError(
                f"the sensor {name!r} has {one!r} and {other!r} correlated in "
                f"{count(rows.size, 'row')} ({rows_text(rows)}), by up to {size.max():.3g}, and "
                f"{variable!r} has their variances alone: give it the component "
                f"{one + JOINED + other!r}, too, or the stream no covariances, "
                "stream.replace(variances=stream.variances)",
                variable=variable,
            )


def require_variances(
    variances: Any, sensors: Mapping[Variable, str]
) -> Mapping[Variable, Variable]:
    """Check `variances`: observed parents by sensor, for sensors that are asked for."""
    if isinstance(variances, Variable):
        raise EvidenceError(
            f"variances= says whose they are, like {{{next(iter(sensors), 'z')!r}: {variances!r}}}",
            variable=variances,
        )
    found = as_mapping(variances, "variances=")
    for variable, one in found.items():
        require_variable(one, "variances=")
        if variable not in sensors:
            raise EvidenceError(
                f"variances= has {variable!r}, which is not in sensors=: ({listed(sensors)})",
                variable=one,
            )
    return found


def columns(variable: Variable, stream: Stream) -> Array:
    """The columns of a variable's components by name and in its units, without the duration."""
    found = _named(variable, stream, stream.values)
    return found * [_size(variable, stream, name) for name in variable.components if name != DT]


def _size(variable: Variable, stream: Stream, component: str) -> float:
    unit = stream.units[stream.place(component)]
    return quantities.converted(variable, component, unit, "the stream")


def _named(variable: Variable, stream: Stream, values: Array) -> Array:
    """The columns of values (M, k) of a stream that are called like a variable's components."""
    names = [name for name in variable.components if name != DT]
    lost = [name for name in names if name not in stream.components]
    if lost:
        raise EvidenceError(
            f"{variable!r} has the components {listed(names)}, and the stream "
            f"{listed(stream.components)}; they go by name",
            variable=variable,
        )
    return values[:, [stream.place(name) for name in names]]


def places(recording: Recording, name: str, stream: Stream, landmark: Variable) -> Array:
    """The place of each sighting's subject, (M, d)."""
    assert stream.subject is not None
    lost = without_place(stream, recording.landmarks)
    if lost.any():
        strangers = sorted(set(stream.subject[lost].tolist()), key=str)
        raise EvidenceError(
            f"of the sightings of {name!r}, {count(int(lost.sum()), 'row')} "
            f"({rows_text(np.flatnonzero(lost))}) have a subject without a place, "
            f"{listed(strangers)}; recording.located() leaves them out",
            variable=landmark,
        )
    size = landmark.dimension
    short = [key for key, place in recording.landmarks.items() if place.size < size]
    if short:
        raise EvidenceError(
            f"{landmark!r} has {size} components, and the landmark {short[0]!r} "
            f"{recording.landmarks[short[0]].size}",
            variable=landmark,
        )
    found = [recording.landmarks[key][:size] for key in stream.subject.tolist()]
    metres = [
        1.0 if name in landmark.angles else quantities.converted(landmark, name, "m", "landmarks")
        for name in landmark.components
    ]
    return np.array(found).reshape(-1, size) * metres


def without_place(stream: Stream, landmarks: Mapping[Hashable, Array]) -> Mask:
    """The mask of sightings whose subject has no place; none where no subject is told."""
    if stream.subject is None:
        return np.zeros(len(stream), dtype=bool)
    return np.array([key not in landmarks for key in stream.subject.tolist()], dtype=bool)


def require_variable(variable: Any, what: str) -> None:
    """Refuse a key or value that is not a Variable."""
    if not isinstance(variable, Variable):
        raise EvidenceError(f"{what} names a variable, not {variable!r}")
