"""The topics of the IMU, the receiver and other sensors in a recording: by message type and by content."""
from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mems_ins_fusion.filter.measurements.base import IMU
from mems_ins_fusion.filter.measurements.fix_quality import FIELDS as QUALITY
from mems_ins_fusion.filter.measurements.position import is_fix
from mems_ins_fusion.filter.measurements.registry import TYPES
from mems_ins_fusion.recordings.bags import Bag
from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.messages import TEMPERATURE
from mems_ins_fusion.recordings.motion import robust_sigma, sigmas
from mems_ins_fusion.recordings.reading import FIX_TYPES, read_recording
from mems_ins_fusion.recordings.remarks import count_of
from mems_ins_fusion.recordings.transforms import sensor_poses
from mems_ins_fusion.samples import Fixes, ImuSamples

#: names of topics with results or references, not measurements
_DERIVED = re.compile(r'reference|truth|fused|filter|ekf|odom|estimate|gt($|/)', re.IGNORECASE)
#: measurements other than IMU samples and fixes, by message type
_AIDING = {kind: tuple(one for one in TYPES.values() if kind in one.messages)
           for kind in dict.fromkeys(kind for one in TYPES.values() for kind in one.messages) if kind not in FIX_TYPES}
#: those without samples of an IMU, whose orientation is not a separate measurement of the heading
_OTHERS = [kind for kind in _AIDING if kind != IMU]
#: smallest share of usable messages and axes of an IMU
_LEAST_USABLE = 0.5
#: rad: messages of one fix differ by less, 6 cm on the ground; u-blox rounds to 1 cm
_SAME_LATITUDE = 1e-8


@dataclass(frozen=True)
class Candidate:
    """A topic that may be used. rate: Hz. jitter: scatter of the intervals, relative. usable: share of its messages.
    derived: whether its name is that of a result or a reference. samples: its samples. sigma: m, as stated by a
    receiver, or NaN."""

    topic: str
    messages: int
    rate: float
    jitter: float
    usable: float
    derived: bool
    samples: ImuSamples | Fixes = field(repr=False)
    sigma: float = np.nan

    def describe(self) -> str:
        """Its content in a few words."""
        words = [f'{self.messages} messages, {self.rate:.3g} Hz']
        if self.usable < 0.995:
            what = 'as an IMU' if isinstance(self.samples, ImuSamples) else 'as fixes'
            words.append(f'{self.usable:.0%} usable {what}')
        if self.jitter > 0.02:
            words.append(f'intervals scatter by {self.jitter:.0%}')
        if np.isfinite(self.sigma):
            words.append(f'stated sigma {self.sigma:.3g} m')
        if self.derived:
            words.append('a reference or a result by its name')
        return ', '.join(words)


@dataclass(frozen=True)
class Topics:
    """The topics of a recording; the first one of each tuple is used. others: by topic, its possible samples by the
    name of the measurement. places: by topic, from the recording's transforms: the place of the measurement, (3,) m,
    and the rotation (3, 3) from its axes, in base_link (`transforms.sensor_poses`)."""

    imu: tuple[Candidate, ...]
    gnss: tuple[Candidate, ...]
    temperature: tuple[str, ...]
    others: Mapping[str, Mapping[str, object]] = field(default_factory=dict)
    places: Mapping[str, tuple[np.ndarray, np.ndarray]] = field(default_factory=dict)

    @property
    def mounting_of_tf(self) -> np.ndarray | None:
        """Rotation (3, 3) from sensor axes to base_link by the transforms; None without one."""
        return self.places[self.imu[0].topic][1] if self.imu[0].topic in self.places else None

    @property
    def arms_of_tf(self) -> dict[str, np.ndarray]:
        """By topic, (3,) m from the IMU to the place of the measurement, base_link, by the transforms; without topics
        whose frame is at the IMU, as if all had one frame."""
        if self.imu[0].topic not in self.places:
            return {}
        imu = self.places[self.imu[0].topic][0]
        return {topic: place - imu for topic, (place, _) in self.places.items() if (place != imu).any()}

    @property
    def arm_of_tf(self) -> np.ndarray | None:
        """(3,) m, from the IMU to the antenna by the transforms; None without one."""
        return self.arms_of_tf.get(self.gnss[0].topic) if self.gnss else None

    @property
    def imus(self) -> dict[str, ImuSamples]:
        """The samples of further IMUs, by topic; without results (by name) and topics with few usable samples."""
        return {one.topic: one.samples for one in self.imu[1:] if not one.derived and one.usable >= _LEAST_USABLE}

    @property
    def receivers(self) -> dict[str, Fixes]:
        """The fixes of further receivers, by topic; without results (by name)."""
        return {one.topic: one.samples for one in self.gnss[1:] if not one.derived}


def find_topics(path) -> Topics:
    """All IMUs and receivers of the recording `path`, the best of each kind first. RecordingError without an IMU."""
    with Bag(path) as bag:
        kinds, counts = bag.topics, bag.counts()
        where = sensor_poses(bag, {name: kind for name, kind in kinds.items()
                                   if kind in (IMU, *FIX_TYPES, *_OTHERS) and counts[name]})
    named = {kind: sorted(name for name, k in kinds.items() if k == kind and counts[name] > 1)
             for kind in (IMU, *FIX_TYPES, TEMPERATURE, *_OTHERS)}
    if not named[IMU]:
        there = ', '.join(f'{name} ({kind}, {count_of(counts[name], "message")})'
                          for name, kind in sorted(kinds.items()))
        raise RecordingError(f'{path} has no topic with two or more messages of type {IMU}'
                             f'{f", only {there}" if there else ""}')
    imu = tuple(sorted((_imu(path, name) for name in named[IMU]), key=_imu_rank))
    gnss = tuple(sorted((_gnss(path, name, named[IMU][0]) for kind in FIX_TYPES for name in named[kind]),
                        key=_gnss_rank))
    # of one receiver's topics that with the quality of its fixes
    gnss = tuple(sorted(gnss, key=lambda one: not (kinds[one.topic] in QUALITY and _are_same(one, gnss[0]))))
    others = {name: _read(path, name, kind, named[IMU][0]) for kind in _OTHERS for name in named[kind]}
    # a heading by two antennas is an Imu message without rates and forces
    others |= {one.topic: _read(path, one.topic, IMU, named[IMU][0]) for one in imu[1:] if one.usable < _LEAST_USABLE}
    return Topics(imu, gnss, tuple(named[TEMPERATURE]), others, where)


def _imu(path, topic) -> Candidate:
    samples = read_recording(path, topic).imu
    both = np.hstack([samples.specific_force, samples.angular_rate])
    finite = np.isfinite(both).all(axis=1)
    alive = 0.0 if len(both) < 2 else float((np.ptp(both[finite], axis=0) > 0).mean()) if finite.any() else 0.0
    return Candidate(topic, len(samples), *_stamps(samples), usable=float(finite.mean()) * alive,
                     derived=bool(_DERIVED.search(topic)), samples=samples)


def _gnss(path, topic, imu_topic) -> Candidate:
    fixes = read_recording(path, imu_topic, topic).gnss
    valid = is_fix(fixes)
    stated = sigmas(fixes.select(valid))
    return Candidate(topic, len(fixes), *_stamps(fixes), usable=float(valid.mean()),
                     derived=bool(_DERIVED.search(topic)), samples=fixes,
                     sigma=float(np.nanmedian(stated)) if np.isfinite(stated).any() else np.nan)


def _are_same(one: Candidate, other: Candidate) -> bool:
    """Whether two topics have the same fixes: most of their stamps and, at these, the positions."""
    _, at, there = np.intersect1d(one.samples.stamp, other.samples.stamp, return_indices=True)
    if len(at) < 0.5 * min(len(one.samples), len(other.samples)):
        return False
    return bool(np.median(np.abs(one.samples.latitude[at] - other.samples.latitude[there])) < _SAME_LATITUDE)


def _read(path, topic, kind, imu_topic) -> dict[str, object]:
    """The possible samples of the messages of `topic`, of the type `kind`, by the name of the measurement."""
    read = read_recording(path, imu_topic, inputs=_AIDING[kind],
                          **{one.topic: topic for one in _AIDING[kind]}).streams()
    return {one.name: read[one.name] for one in _AIDING[kind]}


def _stamps(samples):
    """Rate, Hz, and relative scatter of the intervals."""
    steps = np.diff(samples.stamp) * 1e-9
    advancing = steps[steps > 0]
    if not len(advancing):
        return 0.0, np.inf
    interval = float(np.median(advancing))
    return 1.0 / interval, robust_sigma(steps) / interval + float((steps <= 0).mean())


def _imu_rank(candidate: Candidate):
    """Order: measurements before results; then usable, evenly stamped and fast ones; then by name."""
    return (candidate.derived, -round(candidate.usable, 2), round(candidate.jitter, 1), -round(candidate.rate, -1),
            candidate.topic)


def _gnss_rank(candidate: Candidate):
    """Order: measurements before references; then by the usable share, the stated sigma, and the rate."""
    return (candidate.derived, -round(candidate.usable, 2),
            round(candidate.sigma, 3) if np.isfinite(candidate.sigma) else 1e3, round(candidate.jitter, 1),
            -candidate.rate, candidate.topic)
