"""What changes while a vehicle drives: when the diagnosis finds it, the filter has it, and what is old is dropped.

    python studies/online_changes.py [--seeds 1] [--first-seed 9400] [--minutes 16] [--rate 50] [--receiver RTK]
                                     [--rows 0 1 ...] [--find] [--kept] [-v]

Realistic drives (studies/vehicle.py) in which the receiver's time offset, the place of the antenna, the IMU's mounting
or a scale is another one from a third of the drive on, or until there, or from the begin on two at once. The seed gives
the signs. Each is driven as a live node drives with `diagnosis.online: apply` and analyses that count a minute after
their begin (`diagnosis.share: 1`); without --find analyses find nothing, so that all comes from the look of each
minute, which knows nothing of scales. For each effect: after how many seconds from the change on it was on trial,
proven, and driven with; value and sigma beside the true one; after how many seconds the filter went on without an old
value, and, of an antenna, when the first turn after the change begins, as it shows in turns alone, and the RMS position
error of a minute from then on. Then that of the last third, m, with the parameters as given and with `apply`. --kept:
the effects are known from an earlier drive. -v: all that was said.
"""
from __future__ import annotations

import argparse
from dataclasses import dataclass, fields, replace

import numpy as np
from online import error, rms
from vehicle import FIXES, sensors

from mems_ins_fusion.diagnosis.estimate import Estimate
from mems_ins_fusion.diagnosis.online import OTHER
from mems_ins_fusion.diagnosis.quantity import COARSE, FINE, EarlierFinding
from mems_ins_fusion.diagnosis.watch import RecordingWatch
from mems_ins_fusion.effects.registry import effect_called
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import simulate_recording

OFFSET, ARM = ('gnss_time_offset', {'time_offset': 0.25}), ('gnss_lever_arm', {'x': 1.2, 'y': -0.8})
TURN = 0.15  # rad/s
MINUTE = 60 * 10**9  # ns
MOUNTING = 'mounting_rotation', {'yaw': 0.15}
SCALE = 'gyroscope_scale', {'z': 0.03}  # which the analyses know, and not the look
#: effects, and the parts of the drive in which they are there
ROWS = (((OFFSET,), 1 / 3, 1.0), ((OFFSET,), 0.0, 0.5), ((ARM,), 1 / 3, 1.0), ((ARM,), 0.0, 0.5),
        ((OFFSET, ARM), 0.0, 1.0), ((OFFSET, ARM), 1 / 3, 1.0), ((OFFSET, MOUNTING), 0.0, 1.0),
        ((SCALE,), 1 / 3, 1.0), ((SCALE,), 0.0, 1.0))


@dataclass(frozen=True)
class Case:
    """A recording, true parameters by effect and name, and when they change, s."""

    recording: Recording
    true: dict[str, dict[str, float]]
    begin: float
    end: float


def made(row: tuple, seed: int, minutes: float, rate: float, receiver: str) -> Case:
    """The drive of a row: two recordings of it, with the effects and without, in turn."""
    effects, first, last = row
    drive, distortions = REALISTIC.drive(60.0 * minutes, seed, rate), REALISTIC.distortions(seed)
    always = [] if any(name == MOUNTING[0] for name, _ in effects) else distortions['effects']
    true = {name: {p: v * (-1) ** (seed + k) for k, (p, v) in enumerate(sizes.items())} for name, sizes in effects}

    def recorded(more) -> Recording:
        return simulate_recording(drive, sensors(), FIXES[receiver], seed=seed, vibration=distortions['vibration'],
                                  effects=[*always, *more]).recording
    there, gone = recorded([(effect_called(name), sizes) for name, sizes in true.items()]), recorded([])
    streams = {}
    for name, samples in there.streams().items():
        part = np.arange(len(samples.stamp)) / len(samples.stamp)
        inside, other = (part >= first) & (part < last), gone.streams()[name]
        own = {f.name: (getattr(samples, f.name), getattr(other, f.name)) for f in fields(samples)}
        streams[name] = type(samples)(**{n: None if a is None else np.where(
            inside.reshape(-1, *[1] * (a.ndim - 1)), a, b) for n, (a, b) in own.items()})
    recording = replace(there.having(streams), speed=None, velocity=None, heading=None)
    recording = replace(recording, reference=recording.reference.select(slice(None, None, round(rate / 10))))
    seconds = 60.0 * minutes
    return Case(recording, true, seconds * first, seconds * last if last < 1.0 else 0.0)


def known(case: Case, values: dict) -> list[EarlierFinding]:
    """The effects of `case` as an earlier drive has found them, exactly."""
    found = []
    for name, true in case.true.items():
        effect = effect_called(name)
        sizes = {one.name: true.get(one.name, 0.0) for one in effect.traced}
        sets = {n: v for n, v in effect.adjusted(values, sizes).items() if v != values.get(n)}
        units = {one.name: one.unit for one in effect.traced}
        found.append(EarlierFinding(name, {p: Estimate(v, 0.05, units[p]) for p, v in true.items()}, sets))
    return found


def first_turn(case: Case) -> float:
    """s after the end of the effects at which the next turn begins."""
    imu = case.recording.imu
    at = (imu.stamp - imu.stamp[0]) * 1e-9 - case.end
    turning = at[(at > 0.0) & (np.abs(imu.angular_rate[:, 2]) > TURN)]
    return float(turning[0]) if len(turning) else np.nan


def told(case: Case, receiver: str, row: tuple, seed: int, options) -> str:
    """A line of the table."""
    recording = case.recording
    values = table.check({'diagnosis.online': 'apply', 'diagnosis.share': 1.0})
    watch = RecordingWatch(replace(recording, reference=None), values, kept=known(case, values) if options.kept else (),
                           find=None if options.find else lambda part, given: [])
    as_given, _ = error(recording, values)
    apply, run = error(recording, values, watch)
    zero, cells = int(recording.imu.stamp[0]), []
    said = [((q.time - zero) * 1e-9, q) for q in watch.said]
    if options.v:
        print(*(f'    {at:6.0f} s {q.name} {q.state} applied={q.applied}: {q.text}' for at, q in said), sep='\n')
        print(*(f'    {(h.stamp - zero) * 1e-9:6.0f} s {h.text}' for h in run.handovers), sep='\n')
    wrong = sorted({q.name for _, q in said if q.applied and q.name.removesuffix(OTHER) not in case.true
                    and q.name != MOUNTING[0]})
    for name, true in case.true.items():
        mine = [(at - case.begin, q) for at, q in said if q.name.removesuffix(OTHER) == name and at > case.begin]
        tried, proven, applied = (next(((at, q) for at, q in mine if which(q)), (np.nan, None)) for which in (
            lambda q: q.state == COARSE, lambda q: q.state == FINE, lambda q: q.applied))
        drives = next((at for at in ((h.stamp - zero) * 1e-9 - case.begin for h in run.handovers)
                       if at >= applied[0]), np.nan)
        found = {} if applied[1] is None else applied[1].parameters
        value = ', '.join(f'{p} {e.text()} ({(e.value - true.get(p, 0.0)) / e.sigma:+.1f} sigma)'
                          for p, e in found.items() if e.known)
        dropped = [(one.stamp - zero) * 1e-9 for one in run.dropped if one.name == name]
        changed = [(one.stamp - zero) * 1e-9 for one in run.handovers]
        had = [q.sets for at, q in said if q.name == name and q.applied and at <= case.end]
        taken_back = [at for at, q in said if q.name == name and at > case.end and had and (
            q.sets != had[-1] or not q.applied)]
        gone = [*dropped, *(next((to for to in changed if to >= at), np.inf) for at in taken_back)]
        end = f'; without it after {min(gone, default=np.inf) - case.end:.0f} s' if case.end else ''
        turn = ''
        if case.end and name == ARM[0]:
            begin = zero + (case.end + first_turn(case)) * 1e9
            turn = (f', first turn {first_turn(case):.0f} s, '
                    f'{rms(recording, run, begin, begin + MINUTE):.2f} m from then on')
        cells.append(f'{name} {true}: on trial {tried[0]:.0f}, FINE {proven[0]:.0f}, applied {applied[0]:.0f}, drives '
                     f'{drives:.0f} s; {value}{end}{turn}')
    return (f'| {receiver} {seed} | {row[1]:.0%} to {row[2]:.0%} | {"; ".join(cells)} | {", ".join(wrong) or "none"} | '
            f'{as_given:.2f} | {apply:.2f} |')


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=1)
    parser.add_argument('--first-seed', type=int, default=9400)
    parser.add_argument('--minutes', type=float, default=16.0)
    parser.add_argument('--rate', type=float, default=50.0)
    parser.add_argument('--receiver', choices=FIXES, default='RTK')
    parser.add_argument('--rows', type=int, nargs='+', default=list(range(len(ROWS))))
    parser.add_argument('--find', action='store_true')
    parser.add_argument('--kept', action='store_true')
    parser.add_argument('-v', action='store_true')
    options = parser.parse_args()
    print('| drive | there | effects | others applied | as given | apply |')
    print(f'|{"---|" * 6}', flush=True)
    for row in (ROWS[k] for k in options.rows):
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            case = made(row, seed, options.minutes, options.rate, options.receiver)
            print(told(case, options.receiver, row, seed, options), flush=True)


if __name__ == '__main__':
    main()
