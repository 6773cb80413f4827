"""From recordings to a vehicle's parameters: each with its evidence, and what the recordings do not show."""
from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import Rotation

from mems_ins_fusion.configuration.drive_settings import against_tf, settings_of
from mems_ins_fusion.configuration.input_settings import inputs_against_tf, placed
from mems_ins_fusion.configuration.inputs import InputShown, UnusedTopic, further_imus, shown_inputs
from mems_ins_fusion.configuration.mounting import SHOWN, Mounting, deviation, estimate_mounting
from mems_ins_fusion.configuration.noise import Noise, find_noise
from mems_ins_fusion.configuration.offset import together
from mems_ins_fusion.configuration.receiver import Receiver, assess_receiver
from mems_ins_fusion.configuration.regression import weighted
from mems_ins_fusion.configuration.remaining import Remaining, remaining_of
from mems_ins_fusion.configuration.setting import Setting
from mems_ins_fusion.configuration.topics import Candidate, Topics, find_topics
from mems_ins_fusion.configuration.vehicle import Vehicle, assess_vehicle
from mems_ins_fusion.filter.prediction import UNKNOWN_YAW_SIGMA
from mems_ins_fusion.filter.runs.usable import usable
from mems_ins_fusion.navigation.earth import STANDARD_GRAVITY
from mems_ins_fusion.navigation.earth import gravity as gravity_at
from mems_ins_fusion.parameters.parameter import ParameterError
from mems_ins_fusion.parameters.table import defaults, parameters_of
from mems_ins_fusion.recordings.checker import INFO, Remark, check_recording, check_stamps
from mems_ins_fusion.recordings.errors import RecordingError
from mems_ins_fusion.recordings.motion import find_standstill, without_turns
from mems_ins_fusion.recordings.remarks import checked_text
from mems_ins_fusion.recordings.several import refuse_twice
from mems_ins_fusion.recordings.sketch import sketch
from mems_ins_fusion.recordings.units import Units, find_units, in_si
from mems_ins_fusion.samples import Fixes, ImuSamples, Recording


@dataclass(frozen=True)
class RecordingEvidence:
    """One recording and what it shows. imu: in SI units. still: (n,) its samples at rest. seconds: its length. inputs:
    what its other topics measure, and which are not used."""

    name: str
    imu: ImuSamples
    fixes: Fixes | None
    still: np.ndarray
    seconds: float
    units: Units
    mounting: Mounting | None
    noise: Noise | None
    receiver: Receiver | None
    vehicle: Vehicle
    remarks: tuple[Remark, ...] = ()
    inputs: tuple[InputShown | UnusedTopic, ...] = ()


@dataclass(frozen=True)
class Configuration:
    """The parameters found, and all they stand on. mounting: of all drives together. missing: what the recordings do
    not show, in words. wrong: what is wrong with them."""

    settings: tuple[Setting, ...]
    topics: Topics
    drives: tuple[RecordingEvidence, ...]
    mounting: Mounting | None
    missing: tuple[str, ...]
    wrong: tuple[str, ...] = ()

    @property
    def values(self) -> dict:
        return {setting.name: setting.value for setting in self.settings}

    @property
    def left(self) -> tuple[Remaining, ...]:
        """What the recordings leave of the values: by what these may still be off."""
        return remaining_of(self.mounting, {**defaults(), **self.values})


def configure(paths, progress=lambda part, what: None) -> Configuration:
    """The parameters of the vehicle that the recordings `paths` are from. progress: called with a part, 0 to 1.

    The topics are those of the first recording. RecordingError where one cannot be used.
    """
    topics, drives, fixes = None, [], []
    for i, path in enumerate(paths):
        progress(i / len(paths), 'reading')
        found = find_topics(path)
        topics = topics or found
        imu = _same(found.imu, topics.imu[0].topic, path)
        gnss = _same(found.gnss, topics.gnss[0].topic, path) if topics.gnss else None
        progress((i + 0.5) / len(paths), 'looking')
        fixes.append(gnss.samples if gnss else None)
        receivers = {**found.receivers, **({found.gnss[0].topic: found.gnss[0].samples} if found.gnss else {})}
        receivers.pop(topics.gnss[0].topic if topics.gnss else '', None)
        imus = {**found.imus, found.imu[0].topic: found.imu[0].samples}
        imus.pop(topics.imu[0].topic)
        drives.append(evidence_of_recording(path, imu.samples, fixes[-1], found.others, receivers, imus))
        for other in drives[:-1]:
            refuse_twice(drives[-1], other)
    progress(1.0, 'done')
    return configured(topics, drives, fixes)


def configured(topics: Topics, drives: Sequence[RecordingEvidence], fixes: Sequence[Fixes | None]) -> Configuration:
    """The parameters of the vehicle that `drives` show together. fixes: of each, as recorded."""
    mounting = _together([drive.mounting for drive in drives if drive.mounting is not None])
    against = tuple(against_tf(topics, mounting))
    if against:  # transforms with a wrong mounting of the IMU are not used for other sensors either
        topics = replace(topics, places={})
    # a frame left at its default says nothing of other sensors
    astray = dict(inputs_against_tf(topics, [drive.inputs for drive in drives]))
    topics = replace(topics, places={topic: place for topic, place in topics.places.items() if topic not in astray})
    drives = [replace(drive, inputs=tuple(placed(topics, one) for one in drive.inputs)) for drive in drives]
    settings, beyond = _possible([*settings_of(topics, drives, mounting),
                                  Setting('fitted_to', sketch(fixes),
                                          ['hashes of the recordings that the values are from'])])
    return Configuration(tuple(settings), topics, tuple(drives), mounting,
                         tuple(_missing(topics, drives, mounting)),
                         (*_wrong(topics, drives), *against, *astray.values(), *beyond))


def _possible(found: Iterable[Setting]) -> tuple[list[Setting], list[str]]:
    """The settings that can be set, and what is wrong with the others: a recording may show what no vehicle does."""
    found = list(found)
    known = parameters_of({setting.name: setting.value for setting in found})
    settings, beyond = [], []
    for setting in found:
        try:
            known[setting.name].check(setting.value)
        except ParameterError as error:
            beyond.append(f'{error}; not set')
        else:
            settings.append(setting)
    return settings, beyond


def _same(candidates, topic, path) -> Candidate:
    match = [candidate for candidate in candidates if candidate.topic == topic]
    if not match:
        raise RecordingError(f"{path} has no messages on '{topic}', which the first recording has; give recordings of "
                             'one vehicle')
    return match[0]


def evidence_of_recording(path, imu: ImuSamples, fixes: Fixes | None,
                          others: Mapping[str, Mapping[str, object]] = MappingProxyType({}),
                          receivers: Mapping[str, Fixes] = MappingProxyType({}),
                          imus: Mapping[str, ImuSamples] = MappingProxyType({})) -> RecordingEvidence:
    """All that one recording shows. others, receivers, imus: by topic, as recorded, see `shown_inputs` and
    `further_imus`."""
    name = str(path)
    seen = usable(Recording(name, imu, fixes))
    good = seen.gnss if seen.gnss is not None and len(seen.gnss) > 1 else None
    if len(seen.imu) < 2:
        raise RecordingError(f'{name}: the IMU has no samples that could be used (numbers '
                             'within range, gyroscopes that show more than zero, advancing stamps)')
    whole, imu = imu, seen.imu
    seconds = float(np.ptp(imu.stamp)) * 1e-9
    gravity = float(gravity_at(good.latitude[0], good.height[0])) if good is not None else STANDARD_GRAVITY
    units = find_units(imu, good, gravity)
    imu = in_si(imu, units.acceleration, units.rate)
    remarks = check_recording(Recording(name, in_si(whole, units.acceleration, units.rate), fixes))
    still = without_turns(find_standstill(imu, good), imu)
    found = estimate_mounting(imu, good, gravity)
    receiver = assess_receiver(good, imu, still, found) if good is not None else None
    noise = receiver.realised if receiver is not None else None
    vehicle = assess_vehicle(imu, still, found, noise or 1.0, good)
    inputs = (*shown_inputs(others, receivers, imu, good, still, found), *further_imus(imus, imu, good, gravity))
    samples = {**{topic: next(iter(read.values())) for topic, read in others.items()}, **receivers, **imus}
    remarks += [remark for one in inputs if isinstance(one, InputShown)
                for remark in check_stamps(one.topic, samples[one.topic])]
    return RecordingEvidence(name, imu, good, still, seconds, units, found, find_noise(imu, still), receiver, vehicle,
                             tuple(remark for remark in remarks if remark.severity != INFO), inputs)


def _together(found: list[Mounting]) -> Mounting | None:
    """One mounting of several drives, weighted by their sigmas; larger sigmas where they contradict each other."""
    if len(found) < 2:
        return found[0] if found else None
    best = min(found, key=lambda mounting: float((mounting.sigma**2).sum()))
    away = np.array([deviation(mounting.rotation, best.rotation) if mounting.yaw_known or not best.yaw_known
                     else np.zeros(3) for mounting in found])
    sigma = np.array([mounting.sigma for mounting in found])
    sigma[:, 2] = np.where(sigma[:, 2] < SHOWN, sigma[:, 2], 1e3)
    rotation, rotation_sigma = weighted(away, sigma)
    bias, bias_sigma = weighted(np.array([m.bias for m in found]), np.array([[m.bias_sigma] * 3 for m in found]))
    rotation_sigma[2] = min(rotation_sigma[2], UNKNOWN_YAW_SIGMA)
    return replace(best, rotation=Rotation.from_rotvec(rotation).as_matrix() @ best.rotation, sigma=rotation_sigma,
                   offset=together([m.offset for m in found if m.offset is not None]), bias=bias,
                   bias_sigma=float(bias_sigma.max()), imu=tuple(float(x) for x in weighted(
                       np.array([m.imu[0] for m in found]), np.array([min(m.imu[1], 1e3) for m in found]))))


def _missing(topics, drives, mounting):
    """What the recordings do not show, and what would."""
    if not topics.gnss:
        yield 'no fixes in the recording: yaw, time offset and receiver are at their defaults'
        return
    if mounting is None or not mounting.yaw_known:
        yield ('the yaw of the mounting is not shown: record a drive with a right-angled turn, some braking and '
               'some speeding up')
    if mounting is not None and not any(drive.still.any() for drive in drives):
        yield 'no standstill: sensor noise, gyroscope.bias and vehicle.zero_velocity are left at their defaults'
    if all(drive.units.steering is None for drive in drives):
        yield f'no turns clear enough to tell the unit of the gyroscopes; {drives[0].units.rate} is taken'
    if mounting is None or mounting.offset is None or not mounting.offset.shown:
        yield 'the time offset between IMU and fixes is not shown'


def _wrong(topics, drives):
    """What is wrong with the recordings, each once."""
    names = {part: found[0].topic for part, found in (('imu', topics.imu), ('gnss', topics.gnss)) if found}
    said = [checked_text(remark, names) for drive in drives for remark in drive.remarks]
    units = {(drive.units.acceleration, drive.units.rate) for drive in drives}
    if len(units) > 1:
        said.append('the recordings are in different units; those of the first are written')
    return dict.fromkeys(said)


