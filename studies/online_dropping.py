"""By which test a filter that drives should drop a value that has become wrong: bets, or Page's test.

    python studies/online_dropping.py [--moved 4] [--right 16] [--first-seed 55000] [--minutes 20] [--apart 100]
    python studies/online_dropping.py --jumps 5 [--first-seed 61020]

The innovations, each second, of the filter that drives and of one beside it without a value go into the bets of
`filter/runs/betting.py` and into Page's test (E. S. Page, "Continuous inspection schemes", Biometrika 41, 1954): the
sum of the logarithms of likelihood ratios, zero where it is negative. Errors of the right filter have the Cauchy
distribution in the plane there, of a scale twice the mean distance B of the latest fixes from the nearer prediction: no
distribution with that mean has more than B / r of it beyond r (Markov). Either drops at 11.4, the logarithm of a day.

moved: an antenna at 1.2, 0.8 m that goes in the middle (`online_changes.py`, RTK). s after the change: the first turn,
when the estimate begins to move to the filter without it, and when either test drops it.
jumps: the same drives from BEFORE s before the change on, by filters as they are: when the estimate first moves to one
without the antenna's arm, s after the change, and in the minute after the change the RMS position error and how often
the truth is in the 95 % ellipse; then both by filters that do not go on from the jump of the fixes (`_branch`).
right: a right value beside antennas 1.4 and 0.4 m off and time offsets 0.25 and 0.06 s off, and an antenna 0.3 m off
beside one that is as much off on the other side. Each receiver in turn, with a fault of `faults.py` each --apart s in
every second four drives. How many are dropped, and the largest logarithm of the evidence against one.
"""
from __future__ import annotations

import argparse
import math
from collections import defaultdict
from dataclasses import replace

import numpy as np
from faults import FAULTS
from online_chance import INPUTS, with_faults
from online_changes import MINUTE, ROWS, first_turn, made
from vehicle import FIXES, simulated

from mems_ins_fusion.diagnosis.applying import _events
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.runs import changing
from mems_ins_fusion.filter.runs.betting import USUAL, WORTH, Bets
from mems_ins_fusion.navigation.earth import to_local
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording

NEEDED = math.log(changing.DROPPED)
WIDER = 2.0  # scale of the Cauchy distribution, in B
MOVED = 3  # of ROWS
BEFORE = 200.0  # s: the filters have settled by then
WITHIN_95 = 5.99  # chi-square of two components
WRONG = {'antenna 1.4 m': {'gnss.lever_arm': [1.2, -0.8, 0.0]}, 'antenna 0.4 m': {'gnss.lever_arm': [0.3, -0.3, 0.0]},
         'offset 0.25 s': {'gnss.time_offset': 0.25}, 'offset 0.06 s': {'gnss.time_offset': -0.06}}
EITHER_SIDE = ({'gnss.lever_arm': [0.3, 0.0, 0.0]}, {'antennas, either side': {'gnss.lever_arm': [-0.3, 0.0, 0.0]}})


class Both:
    """Both tests in the place of the bets of a parallel filter. Never drops. evidence: s, of bets, of Page's test."""

    seconds, pro = 0.0, -math.inf  # of the newest sample
    usual_distance = 0.0  # so that no filter begins at a jump of the fixes: these two tests alone are compared

    def __init__(self):
        self._bets, self._page, self._usual, self._count = Bets(), 0.0, 0.0, 0
        self.evidence: list[tuple[float, float, float]] = []

    def take(self, present, other) -> None:
        self._bets.take(present, other)
        self._bets.pro = max(self._bets.pro, 0.0)
        of_present, of_other = math.hypot(*present), math.hypot(*other)
        if self._usual > 0.0 and math.dist(present, other) > 2.0 * WORTH:
            scale = (WIDER * self._usual) ** 2
            ratio = 1.5 * (math.log1p(of_present**2 / scale) - math.log1p(of_other**2 / scale))
            self._page = max(self._page + ratio, 0.0)
        self._count += 1
        self._usual += (min(of_present, of_other) - self._usual) / min(self._count, USUAL)
        self.evidence.append((Both.seconds, self._bets.pro, self._page))


def evidence(recording: Recording, present: dict, others: dict[str, dict]) -> dict[str, np.ndarray]:
    """By name of `others`: (k, 3) as of `Both`, for these parameters against `present`."""
    given = table.check({})
    fusion = changing.ChangingFilter(FilterConfig.from_parameters({**given, **present}))
    fusion.watch({name: {**given, **values} for name, values in others.items()})
    imu, events = recording.imu, _events(recording)
    force, rate, event = imu.specific_force.tolist(), imu.angular_rate.tolist(), next(events, None)
    for i, stamp in enumerate(imu.stamp.tolist()):
        Both.seconds = (stamp - int(imu.stamp[0])) * 1e-9
        fusion.add_imu(stamp, *force[i], *rate[i])
        while event is not None and event[0] == i + 1:
            event[1](fusion)
            event = next(events, None)
        if i % 1000 == 0:
            fusion.notices(), fusion.verdicts()
    return {name: np.array(one._bets.evidence).reshape(-1, 3) for name, one in fusion._beside.items()}


def moved(seed: int) -> str:
    """A line of the first table."""
    case = made(ROWS[MOVED], seed, 14.0, 50.0, 'RTK')
    (true,) = case.true.values()
    arm = {'gnss.lever_arm': [true['x'], true['y'], 0.0]}
    seconds, *tests = evidence(replace(case.recording, reference=None), arm, {'without': {}})['without'].T
    dropped = [seconds[(test >= needed) & (seconds > case.end)] - case.end
               for test, needed in ((tests[0], math.log(changing.SHOWN_BETTER)), *((test, NEEDED) for test in tests))]
    return (f'| {seed} | {first_turn(case):.0f} | '
            f"{' | '.join(f'{at[0]:.0f}' if len(at) else 'never' for at in dropped)} |")


def jumped(seed: int) -> str:
    """A line of the table of jumps."""
    case = made(ROWS[MOVED], seed, 14.0, 50.0, 'RTK')
    change = int(case.recording.imu.stamp[0]) + round(case.end * 1e9)
    recording = case.recording.having({name: samples.select(
        (samples.stamp > change - round(BEFORE * 1e9)) & (samples.stamp < change + MINUTE))
        for name, samples in case.recording.streams().items()})
    (true,), truth, cells = case.true.values(), case.recording.reference, []
    for branches in (True, False):
        fusion = changing.ChangingFilter(FilterConfig.from_parameters(
            {**table.check({}), 'gnss.lever_arm': [true['x'], true['y'], 0.0]}))
        if not branches:
            fusion._branch = lambda now: None
        fusion.watch({'without': table.check({})})
        moves, rows, events = None, [], _events(replace(recording, reference=None))
        event = next(events, None)
        for i, stamp in enumerate(recording.imu.stamp.tolist()):
            fusion.add_imu(stamp, *recording.imu.specific_force[i].tolist(), *recording.imu.angular_rate[i].tolist())
            while event is not None and event[0] == i + 1:
                event[1](fusion)
                event = next(events, None)
            if stamp < change:
                continue
            moves = (stamp - change) * 1e-9 if moves is None and fusion._suspected else moves
            k = int(np.searchsorted(truth.stamp, stamp))
            if k < len(truth.stamp) and truth.stamp[k] == stamp:
                fusion.update_odometry()
                north, east, _ = to_local(*fusion.geodetic, (truth.latitude[k], truth.longitude[k], truth.height[k]))
                off = np.array([east, north])
                covariance = fusion.position_covariance_enu.reshape(3, 3)[:2, :2]
                rows.append((off @ off, off @ np.linalg.solve(covariance, off) < WITHIN_95))
        squares, inside = np.array(rows).T
        cells += ['never' if moves is None else f'{moves:.0f}', f'{math.sqrt(squares.mean()):.2f}',
                  f'{inside.mean():.0%}']
    return f"| {seed} | {first_turn(case):.0f} | {' | '.join(cells)} |"


def right(seed: int, minutes: float, apart: float) -> tuple[str, bool, dict[str, np.ndarray]]:
    """Receiver, whether there are faults, and the largest evidence of either test by what is beside."""
    name, faulty = list(FIXES)[seed % len(FIXES)], seed // len(FIXES) % 2 == 1
    recording = replace(simulated(seed, minutes, replace(FIXES[name], rate=1.0)), reference=None,
                        **dict.fromkeys(INPUTS))
    if faulty:
        recording, _ = with_faults(recording, seed, apart, [fault for fault in FAULTS if not fault.values])
    found = {**evidence(recording, {}, WRONG), **evidence(recording, *EITHER_SIDE)}
    return name, faulty, {what: one[:, 1:].max(axis=0, initial=0.0) for what, one in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--moved', type=int, default=4)
    parser.add_argument('--jumps', type=int, default=0)
    parser.add_argument('--right', type=int, default=16)
    parser.add_argument('--first-seed', type=int, default=55000)
    parser.add_argument('--minutes', type=float, default=20.0)
    parser.add_argument('--apart', type=float, default=100.0)
    options = parser.parse_args()
    if options.jumps:
        print('| seed | first turn | moves over | RMS, m | in the ellipse | without: moves over | RMS, m '
              f'| in the ellipse |\n|{"---|" * 8}', flush=True)
        for seed in range(options.first_seed, options.first_seed + options.jumps):
            print(jumped(seed), flush=True)
        return
    changing.Bets = Both
    print(f'| seed | first turn | seems wrong | dropped by bets | by Page\'s test |\n|{"---|" * 5}', flush=True)
    for seed in range(options.first_seed, options.first_seed + options.moved):
        print(moved(seed), flush=True)
    largest = defaultdict(list)
    for seed in range(options.first_seed, options.first_seed + options.right):
        name, faulty, found = right(seed, options.minutes, options.apart)
        largest[name, faulty] += found.values()
    print('| receiver | faults | values | dropped by bets | by Page\'s test | largest, bets | Page\'s test |\n'
          '|---|---|---|---|---|---|---|')
    for (name, faulty), values in largest.items():
        values = np.array(values)
        print(f"| {name} | {'yes' if faulty else 'no'} | {len(values)} | "
              f"{' | '.join(str(n) for n in (values >= NEEDED).sum(axis=0))} | "
              f"{' | '.join(f'{one:.1f}' for one in values.max(axis=0))} |")


if __name__ == '__main__':
    main()
