"""A recording given to a live filter, message by message, as they are received."""
from __future__ import annotations

from collections.abc import Iterator
from dataclasses import fields

import numpy as np


def arrivals(recording, *inputs: str) -> list[tuple[str, int]]:
    """(name of the stream, index) of samples ('imu'), fixes ('gnss') and `inputs` in the order in which they are
    received; of what is received at the same time in this order."""
    streams = recording.streams()
    rows = [(received, order, name, i) for order, name in enumerate(('imu', 'gnss', *inputs))
            for i, received in enumerate(streams[name].received.tolist())]
    return [(name, i) for _, _, name, i in sorted(rows)]


def fed(fusion, recording, *inputs: str, upto: int | None = None) -> Iterator[int]:
    """Give `fusion` what is received before the sample `upto`; yields the index of each sample after which there is a
    new estimate."""
    imu, streams = recording.imu, recording.streams()
    for name, i in arrivals(recording, *inputs):
        if name == 'imu':
            if i == upto:
                return
            if fusion.add_imu(int(imu.stamp[i]), *imu.specific_force[i].tolist(), *imu.angular_rate[i].tolist()):
                yield i
            continue
        part = streams[name]
        numbers = [getattr(part, f.name)[i] for f in fields(part) if f.name not in ('stamp', 'received')]
        if name == 'gnss':
            fusion.add_fix(int(part.stamp[i]), *numbers)
        else:
            fusion.add(name, int(part.stamp[i]), *numbers)


def lived(fusion, recording, *inputs: str, upto: int | None = None) -> dict[int, np.ndarray]:
    """Latitude and longitude, rad, and height, m, that `fusion` publishes, by the index of the sample: as `fed`."""
    found = {}
    for i in fed(fusion, recording, *inputs, upto=upto):
        if fusion.aligned:
            fusion.update_odometry()
            found[i] = fusion.geodetic.copy()
    return found


def same_bits(replayed, found: dict[int, np.ndarray], fewest: int) -> None:
    """Assert that a replay has the places that a live filter has `found`, of more than `fewest` samples."""
    both = np.isin(replayed.index, list(found))
    assert both.sum() > fewest
    places = np.column_stack([replayed.latitude, replayed.longitude, replayed.height])[both]
    assert np.array_equal(places, [found[i] for i in replayed.index[both]])
