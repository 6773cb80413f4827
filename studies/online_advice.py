"""Is the advice of the diagnosis while driving worth following, and true?

    python studies/online_advice.py [--seeds 4] [--first-seed 9600] [--receivers RTK "1.5 m"] [--before 180]
                                    [--noises 1]

Realistic drives (studies/vehicle.py) with one effect from the begin on. After `--before` s the latest samples are
looked at as the node does, and the advice for the finding is computed (`diagnosis/advice.py`). From there the drive
goes on in two ways: the driver repeats the manoeuvre of the advice, or drives as before. The sigma asked for is the one
that the advice predicts for the parameter. *predicted*, *reached*: sigma that the advice predicts and that the look
gives LATER s behind the first manoeuvre, over the sigma before; with --noises of so many recordings of the same drive,
each with other noise. *advised*, *ordinary*: seconds until the look gives the sigma asked for (longest: LONGEST). The
last lines have the medians by receiver, and how often the prediction is within 20 %, of the first recordings.
"""
from __future__ import annotations

import argparse
from collections import defaultdict
from dataclasses import replace

import numpy as np
from vehicle import FIXES, sensors

from mems_ins_fusion.configuration.mounting import estimate_mounting
from mems_ins_fusion.configuration.remaining import ANGLES, ARM, TIME_OFFSET, remaining_of
from mems_ins_fusion.diagnosis.advice import DURATION, Advice, advised
from mems_ins_fusion.diagnosis.direct import shown_directly
from mems_ins_fusion.diagnosis.window import seconds
from mems_ins_fusion.effects.registry import effect_called
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Recording
from mems_ins_fusion.simulation.drive import Path, follow
from mems_ins_fusion.simulation.manoeuvres import ASKED, Segment
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import simulate_recording

#: effects, with their sizes; the seed gives the signs
EFFECTS = (('gnss_lever_arm', {'x': 1.2, 'y': -0.8}), ('gnss_time_offset', {'time_offset': 0.25}),
           ('mounting_rotation', {'yaw': 0.15}))
#: s, of driving on, and from one look to the next
LONGEST, STEP = 300.0, 10.0
#: s behind a manoeuvre that an estimate needs for its last fixes
LATER = 10.0
#: m/s, of a vehicle that drives on
MOVING = 6.0
#: Hz, of the IMU
RATE = 50.0
OTHER_NOISE = 1_000_003  # seeds from one recording of a drive to the next
#: names of the look by parameter
NAMES = {'time_offset': TIME_OFFSET, **dict(zip('xyz', ARM)), **{name: name for name in ANGLES}}


def recorded(path: Path, until: float, seed: int, receiver: str, effect: tuple[str, dict], noise: int = 0) -> Recording:
    """The first `until` s of a path. noise: number of the recording of it."""
    name, sizes = effect
    distortions = REALISTIC.distortions(seed)
    always = [] if name == 'mounting_rotation' else distortions['effects']
    return replace(simulate_recording(follow(path, until, RATE), sensors(), FIXES[receiver],
                                      seed=seed + OTHER_NOISE * noise, vibration=distortions['vibration'],
                                      effects=[*always, (effect_called(name), sizes)]).recording, reference=None)


def begin_of(segments: tuple[Segment, ...], before: float) -> tuple[int, float, float]:
    """How many segments end before the first moment behind `before`, s, at which the vehicle drives on; that moment
    (s) and its speed (m/s)."""
    elapsed = speed = 0.0
    for k, segment in enumerate(segments, 1):
        elapsed, speed = elapsed + segment.duration, speed + segment.speed_change
        if elapsed >= before and speed >= MOVING:
            return k, elapsed, speed
    raise ValueError('the vehicle does not drive on')


def sigma_of(recording: Recording, parameter: str, values: dict) -> float:
    left = {one.name: one for one in remaining_of(estimate_mounting(recording.imu, recording.gnss), values)}
    return left[NAMES[parameter]].sigma


def until_known(recording: Recording, begin: float, parameter: str, asked: float, values: dict) -> float:
    """Seconds behind `begin` after which the look gives the sigma `asked`."""
    first = int(recording.imu.stamp[0])
    for after in np.arange(STEP, LONGEST + STEP, STEP):
        end = first + round((begin + after) * 1e9)
        part = recording.having({n: s.select(s.stamp <= end) for n, s in recording.streams().items()})
        if sigma_of(part, parameter, values) <= asked:
            return float(after)
    return LONGEST


def before_and_behind(recording: Recording, begin: float, parameter: str, values: dict) -> tuple[float, float]:
    """The sigma that the look gives at `begin`, s, and LATER s behind the first manoeuvre."""
    first = int(recording.imu.stamp[0])
    ends = [first + round(s * 1e9) for s in (begin, begin + DURATION + LATER)]
    return tuple(sigma_of(recording.having({n: s.select(s.stamp <= end) for n, s in recording.streams().items()}),
                          parameter, values) for end in ends)


def told(seed: int, receiver: str, effect: tuple[str, dict], before: float, noises: int
         ) -> tuple[str, Advice | None, tuple]:
    """A line of the table, the advice, and how often the sigma before: predicted, reached; s: advised, ordinary."""
    values = table.check({})
    effect = effect[0], {p: v * (-1) ** (seed + k) for k, (p, v) in enumerate(effect[1].items())}
    ordinary = REALISTIC.drive(before + LONGEST + 120.0, seed, RATE).path
    count, begin, speed = begin_of(ordinary.segments, before)
    seen = recorded(ordinary, begin, seed, receiver, effect)
    finding = next((one for one in shown_directly(seen, values) if one.name == effect[0]), None)
    head = f'| {receiver} {seed} | {effect[0]} | '
    advice = None if finding is None else advised(finding, seen, values)
    if advice is None:
        return f"{head}{'not found' if finding is None else 'no advice'} | | | | | |", None, ()
    manoeuvre = ASKED[advice.manoeuvre](speed)
    rest = max(DURATION - sum(one.duration for one in manoeuvre), 0.0)
    once = (*manoeuvre, *([Segment(rest)] if rest else []))
    times = int(LONGEST / DURATION) + 3
    path, until = replace(ordinary, segments=(*ordinary.segments[:count], *once * times)), begin + LONGEST + 5.0
    followed = recorded(path, until, seed, receiver, effect)
    reached = [before_and_behind(followed, begin, advice.parameter, values)[1] / advice.now]
    for noise in range(1, noises):
        now, behind = before_and_behind(recorded(path, begin + DURATION + LATER + 1.0, seed, receiver, effect, noise),
                                        begin, advice.parameter, values)
        reached.append(behind / now)
    further = recorded(ordinary, begin + LONGEST + 5.0, seed, receiver, effect)
    assert seconds(followed) > begin + LONGEST
    known = [until_known(one, begin, advice.parameter, advice.then, values) for one in (followed, further)]
    row = advice.then / advice.now, reached[0], *known
    return (f'{head}{advice.manoeuvre} | {advice.parameter} {advice.now:.2g} {advice.unit} | {row[0]:.2f} | '
            f'{", ".join(f"{one:.2f}" for one in reached)} | {row[2]:.0f} | {row[3]:.0f} |'), advice, row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=4)
    parser.add_argument('--first-seed', type=int, default=9600)
    parser.add_argument('--receivers', nargs='+', choices=FIXES, default=['RTK', '1.5 m'])
    parser.add_argument('--before', type=float, default=180.0)
    parser.add_argument('--noises', type=int, default=1)
    options = parser.parse_args()
    print('| drive | effect | advice | sigma of | predicted | reached | advised, s | ordinary, s |')
    print(f'|{"---|" * 8}', flush=True)
    rows = defaultdict(list)
    for receiver in options.receivers:
        for seed in range(options.first_seed, options.first_seed + options.seeds):
            for effect in EFFECTS:
                line, _, row = told(seed, receiver, effect, options.before, options.noises)
                print(line, flush=True)
                rows[receiver] += [row] if row else []
    for receiver, found in rows.items():
        if found:
            predicted, reached, advised_s, ordinary = np.transpose(found)
            true = np.abs(predicted / reached - 1.0) <= 0.2
            print(f'{receiver}: {len(found)} times; predicted / reached {np.median(predicted / reached):.2f}, within '
                  f'20 % {true.sum()}; time advised / ordinary {np.median(advised_s / ordinary):.2f}, at most half '
                  f'{np.sum(advised_s <= 0.5 * ordinary)}')


if __name__ == '__main__':
    main()
