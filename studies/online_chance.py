"""What the diagnosis while driving applies where there is nothing to be found: chance, and faults.

    python studies/online_chance.py [--hours 10] [--minutes 60] [--processes 1] [--find] [--share 0.1]
                                    [--receivers "1.5 m" RTK] [--rate 1] [--each-fault] [--apart 300]
                                    [--faults ahead,late] [--gaps 0]

Realistic drives (studies/vehicle.py) with the receivers 1.5 m, RTK, city, smoothing in turn, every second one with a
fault of studies/faults.py each five minutes. Each minute the look without a filter, as always; in the place of the
analyses, at the times of these, findings that are wrong: a time offset, an antenna's arm, a scale of the gyroscope of
z, a mounting, each of a size that an analysis would find. So a drive has many times as many trials as one in
which `diagnose` finds nothing, and an hour takes minutes.

--find: the analyses of `diagnose`, which take an hour for some hours. --share: diagnosis.share; with 1 the result of an
analysis counts a minute after its begin, so that an hour has as many analyses as it can have. --rate: of the fixes, Hz.
--inputs: the filter has wheel speed, velocity of the receiver, and heading, with their faults. --each-fault: one fault
for each drive, again and again, each --apart s; all findings are those of the look. --gaps: each so many seconds no
fix for 10 to 90 s, or no sample of the IMU for 0.2 to 3 s.

For each drive: findings on trial, which were FINE, and what was applied; of each value how far it is from the true one
in sigmas. The mounting of realistic drives is some degrees off, which is there to be found; nothing else is.
"""
from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from faults import FAULTS, Fault
from vehicle import FIXES, simulated

from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.findings import Finding
from mems_ins_fusion.diagnosis.held_out import HeldOut
from mems_ins_fusion.diagnosis.quantity import FINE
from mems_ins_fusion.diagnosis.watch import RecordingWatch
from mems_ins_fusion.effects.registry import effect_called
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.scene import REALISTIC

#: effect, parameter, and sizes that an analysis would find
WRONG = (('gnss_time_offset', 'time_offset', (0.05, 0.3)), ('gnss_lever_arm', 'x', (0.5, 2.0)),
         ('gyroscope_scale', 'z', (0.005, 0.03)), ('mounting_rotation', 'yaw', (0.03, 0.1)))

#: topics of the inputs that --inputs gives to the filter
INPUTS = {name: f'/{name}' for name in ('speed', 'velocity', 'heading')}


def wrong_findings(rng: np.random.Generator) -> Callable:
    """Analyses that find two effects of WRONG each time, of random sizes."""
    def find(recording: Recording, values: dict) -> list[Finding]:
        found = []
        for k in rng.choice(len(WRONG), 2, replace=False):
            name, parameter, (least, most) = WRONG[k]
            effect, size = effect_called(name), float(rng.choice((-1.0, 1.0)) * rng.uniform(least, most))
            sizes = {one.name: size if one.name == parameter else 0.0 for one in effect.traced}
            changes = {n: v for n, v in effect.adjusted(values, sizes).items() if v != values.get(n)}
            found.append(Finding(name, [name], {parameter: Estimate(size, 0.2 * abs(size), '')}, 0.0, 0.0, True,
                                 HeldOut(0.0, 1.0, []), changes=changes))
        return found
    return find


def with_faults(recording: Recording, seed: int, apart: float, faults: list[Fault]) -> tuple[Recording, list[str]]:
    """One of `faults` each `apart` s, in random order."""
    rng, names = np.random.default_rng(seed), []
    begin, end = (recording.imu.stamp[k] for k in (0, -1))
    for at in np.arange(apart, (end - begin) * 1e-9 - apart, apart):
        fault = faults[rng.integers(len(faults))]
        inside = [(samples.stamp >= begin + at * 1e9) & (samples.stamp < begin + (at + fault.duration) * 1e9)
                  for samples in (recording.imu, recording.gnss)]
        recording = fault.alter(recording, *inside, rng)
        names.append(fault.name)
    return recording, names


def with_gaps(recording: Recording, seed: int, apart: float) -> Recording:
    """Without fixes, or without samples of the IMU, for a while each `apart` s."""
    rng, begin, kept = np.random.default_rng(seed), recording.imu.stamp[0], {}
    end = (recording.imu.stamp[-1] - begin) * 1e-9
    for name, samples in (('imu', recording.imu), ('gnss', recording.gnss)):
        there = np.ones(len(samples.stamp), dtype=bool)
        after = (samples.stamp - begin) * 1e-9
        least, most = (0.2, 3.0) if name == 'imu' else (10.0, 90.0)
        begins = np.arange(apart, end, apart)
        for at in begins + rng.uniform(0.0, 0.5 * apart, len(begins)):
            there &= (after < at) | (after > at + rng.uniform(least, most))
        kept[name] = samples.select(there)
    return replace(recording, **kept)


@dataclass(frozen=True)
class Drives:
    """How drives are made, and what is told of them: as the options of the command line."""

    minutes: float
    receivers: list[str]
    rate: float
    inputs: bool
    each_fault: bool
    apart: float
    faults: str
    find: bool
    share: float
    gaps: float

    def of(self, seed: int) -> tuple[str, Recording, list[str], dict]:
        """What the drive is, its recording, the faults in it, and the values that its filter is given."""
        name = self.receivers[seed % len(self.receivers)]
        recording = replace(simulated(seed, self.minutes, replace(FIXES[name], rate=self.rate)), reference=None)
        given = {f'{one}_topic': topic for one, topic in INPUTS.items()} if self.inputs else {}
        if not self.inputs:
            recording = replace(recording, **dict.fromkeys(INPUTS))
        faults = [fault for fault in FAULTS if fault.values.items() <= given.items()
                  and any(part in fault.name for part in self.faults.split(','))]
        number, faulty = divmod(seed // len(self.receivers), 2)
        if self.each_fault:
            faults, faulty = [faults[seed % len(faults)]], True
        recording, there = with_faults(recording, seed, self.apart, faults) if faulty else (recording, [])
        if self.gaps:
            recording = with_gaps(recording, seed, self.gaps)
        return f'{name}{", faults" if faulty else ""}{", gaps" if self.gaps else ""}', recording, there, given


def of_drive(seed: int, drives: Drives) -> tuple[str, list, list, list, list[str]]:
    """What the drive is, what was on trial, FINE, and applied, and the faults."""
    name, recording, faults, given = drives.of(seed)
    values = table.check({'diagnosis.online': 'apply', 'diagnosis.share': drives.share, **given})
    wrong = (lambda part, given: []) if drives.each_fault else wrong_findings(np.random.default_rng(seed))
    watch = RecordingWatch(recording, values, find=None if drives.find else wrong)
    while watch.take() is not None:
        pass
    true = {f'mounting_rotation {p}': v for effect, sizes in REALISTIC.distortions(seed)['effects']
            if effect.name == 'mounting_rotation' for p, v in sizes.items()}
    told = [[(round((q.time - recording.imu.stamp[0]) * 1e-9), q.name, *(
        f'{p} {e.text()} ({(e.value - true.get(f"{q.name} {p}", 0.0)) / e.sigma:+.1f} sigma)'
        for p, e in q.parameters.items() if e.known)) for q in watch.said if which(q)]
        for which in (lambda q: q.parameters, lambda q: q.state == FINE, lambda q: q.applied)]
    return name, *told, faults


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--hours', type=float, default=10.0)
    parser.add_argument('--minutes', type=float, default=60.0)
    parser.add_argument('--first-seed', type=int, default=7000)
    parser.add_argument('--processes', type=int, default=1)
    parser.add_argument('--find', action='store_true')
    parser.add_argument('--share', type=float, default=0.1)
    parser.add_argument('--receivers', nargs='+', choices=FIXES, default=list(FIXES))
    parser.add_argument('--rate', type=float, default=1.0)
    parser.add_argument('--inputs', action='store_true')
    parser.add_argument('--each-fault', action='store_true')
    parser.add_argument('--apart', type=float, default=300.0)
    parser.add_argument('--faults', default='', help='those with one of these in their name, separated by commas')
    parser.add_argument('--gaps', type=float, default=0.0)
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + round(options.hours * 60.0 / options.minutes))
    drives = Drives(**{one.name: getattr(options, one.name) for one in dataclasses.fields(Drives)})
    print('| seed | drive | on trial | FINE | applied |\n|---|---|---|---|---|', flush=True)
    with ProcessPoolExecutor(options.processes) as pool:
        for seed, (drive, tried, fine, applied, faults) in zip(seeds, pool.map(of_drive, seeds, [drives] * len(seeds))):
            print(f"| {seed} | {drive} {', '.join(dict.fromkeys(faults))} | {tried or 'none'} | {fine or 'none'} | "
                  f"{applied or 'none'} |", flush=True)


if __name__ == '__main__':
    main()
