"""The trust horizon against what happens: does the error cross the limit later than announced, and by how much?

    python studies/horizon.py [--seeds 5] [--minutes 20] [--limit 5] [--data ../shared/data] [--processes 2]
                              [--parts | --terms]

Realistic simulated drives of each receiver of studies/vehicle.py, with and without a wheel speed, and the measured ones
(mounting given to the nearest right angle; longmont also with its time offset). Fixes are withheld for 120 s from each
20 s on; what the filter announces at the begin is compared with when its horizontal error is larger than the limit for
the first time. `later`: share of outages in which that is later than announced, with the 95 % interval of drives drawn
anew (of a single drive: of its outages, blocks of 120 s). `announced / true`: the median; an outage in which the error
does not cross counts as one that crosses at its end, so that the ratio is at most that. `best possible`: the same for
an announcement that knows the distribution of the true times of its row, 5 % of which are earlier, and nothing else.
`scaled`: the same for an announcement that is this one times a number, the largest with which 5 % of the row cross
earlier: all that another width of the covariance could bring (announcements of 0 s are left out).
`exact`: the ratio that the filter's own prediction would have if it were exact to the last digit: the time at which 5 %
of the errors are larger than the limit over that at which half of them are (median). `narrower`: by how much all
predicted sigmas could be divided with 95 % of the outages still crossing later; below 1 they are too small.

--parts: two receivers, with and without a wheel speed, with one assumption of the filter after the other replaced by
what the simulator does, or left out.

--terms: the same drives; what the horizon would be if a part of the state were known exactly at the begin, or all of
it, or if there were no process noise (medians, s), and the time after which 5 % of the errors are larger than the limit
by the covariance that is published in the outage itself (taken as a circle): that knows how the vehicle went on.
NEES / 2 by the time since the begin: 1 where the published covariance is right, less where it is too wide.

The plain drives have an IMU, a road and a receiver exactly as the parameters say: there the prediction is exact but for
what is learned.
"""
from __future__ import annotations

import argparse
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np
from vehicle import FIXES, MEASURED, measured, simulated

from mems_ins_fusion.evaluation.comparison import samples_to_keep, truth_of
from mems_ins_fusion.evaluation.outages import Outages, outage_begins, run_outages
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import (
    WHITE,
    Head,
    covariance,
    newest_row,
    sample_at,
    set_covariance,
    variance_at,
    walk_at,
)
from mems_ins_fusion.filter.prediction import Turns
from mems_ins_fusion.filter.runs import replay
from mems_ins_fusion.filter.runs.horizon import EXCEEDED, LONGEST_HORIZON, HorizonPredictor
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.trust.force_noise import ForceNoise
from mems_ins_fusion.filter.trust.scale import Scale
from mems_ins_fusion.filter.trust.white_noise import Shown
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding
from mems_ins_fusion.simulation.scene import REALISTIC
from mems_ins_fusion.simulation.simulation import SensorErrors, simulate_drive, simulate_recording

#: s, of an outage, which is as far as is looked ahead, and from one begin to the next
DURATION, SPACING = LONGEST_HORIZON, 20.0
#: the time offset of longmont (docs/closing_the_loop.md), s
OFFSET = {'gnss.time_offset': -0.26}
#: drawn anew for an interval
DRAWS = 2000
#: by which sigmas are divided
NARROWER = np.array([1.0, 0.5, 0.7, 1.3, 1.6, 2.0, 2.5, 3.0])
#: as simulated in place of as assumed, or left out
IMU = REALISTIC.imu
PARTS = {
    'as given': {},
    'IMU as simulated': IMU,
    'drift of the gyroscopes as simulated': {k: v for k, v in IMU.items() if k.startswith('gyroscope.gauss_markov')},
    'white noise of the gyroscopes as simulated': {'gyroscope.noise_density': IMU['gyroscope.noise_density']},
    'white noise not adapted': {'imu.adapt_noise': False},
    'a third of the sideways velocity': {'vehicle.non_holonomic_sigma': 0.1},
    'mounting not estimated': {'imu.mounting_sigma': 0.0},
    'does not drive off': {'horizon.speed': 0.1},
}
#: exactly as the parameters say
PLAIN = 'plain, '
#: --terms: parts of the state by the begin of their names
KNOWN = {'position': ('r_',), 'velocity': ('v_',), 'tilt': ('phi_n', 'phi_e'), 'heading': ('phi_d',),
         'accelerometers': ('f_',), 'tilt and accelerometers': ('phi_n', 'phi_e', 'f_'), 'gyroscopes': ('w_',),
         'mounting': ('mounting',), 'all': ('',)}
#: s since the begin of an outage
AFTER = (1, 2, 5, 10, 20, 30, 60)
#: of a state that is known exactly: sigma 1e-6, in the units of each
EXACT = 1e-12


class Noted(HorizonPredictor):
    """Notes of each outage when half of the errors are larger than the limit, and when 5 % are with sigmas divided by
    NARROWER, s."""

    notes: list = []

    def predict(self, memory, exceeded=0.05, **realised):
        limit = self._limit
        half = super().predict(memory, 0.5, **realised).seconds
        row = []
        for narrower in NARROWER:
            self._limit = limit * narrower
            row.append(super().predict(memory, **realised).seconds)
        self._limit = limit
        self.notes.append((half, *row))
        return super().predict(memory, **realised)


class Terms(HorizonPredictor):
    """Notes of each outage the horizon as it is, with each part of KNOWN known exactly, and without process noise, s.
    """

    notes: list = []

    def __init__(self, config):
        super().__init__(config)
        self._layout = config.layout

    def predict(self, memory, exceeded=0.05, **realised):
        names, row = self._layout.names, []
        for begins in KNOWN.values():
            known = np.array([name.startswith(begins) for name in names])
            row.append(super().predict(self._knowing(memory, known), **realised).seconds)
        row.append(super().predict(self._without_noise(memory), **realised).seconds)
        found = super().predict(memory, **realised)
        self.notes.append((found.seconds, *row))
        return found

    def _knowing(self, memory, known):
        """`memory` with the covariance of the newest state, given those that are `known` (n,) bool."""
        copy, full = memory.copy(), covariance(newest_row(memory), self._layout)
        left = np.where(known, EXACT, 0.0) * np.eye(len(full))
        rest = ~known
        if known.any() and rest.any():
            both = full[np.ix_(rest, known)]
            left[np.ix_(rest, rest)] = full[np.ix_(rest, rest)] - both @ np.linalg.pinv(
                full[np.ix_(known, known)], hermitian=True) @ both.T
        set_covariance(newest_row(copy), self._layout, left)
        return copy

    def _without_noise(self, memory):
        copy, m = memory.copy(), self._layout.n_augmented
        sample = sample_at(copy, int(copy[Head.SAMPLES]))
        for at in (WHITE, sample + Shown.WHITE):
            copy[at:at + 6] = 0.0
        for state in range(m):
            copy[walk_at(m, state)] = copy[variance_at(m, state)] = 0.0
        copy[Turns.NOISE] = newest_row(copy)[ForceNoise.SCALE + Scale.LOG] = 0.0
        return copy


def terms_of(recording, values: dict) -> np.ndarray:
    """(o, 2 + k + t): time at which the error crosses, and by the published covariance (inf: not), as `Terms.notes`,
    and the NEES at AFTER."""
    Terms.notes.clear()
    found = withheld(recording, values, Terms)
    published, nees = [], []
    for begin, errors in zip(found.begin, found.errors):
        time = (errors.stamp - begin) * 1e-9
        over = np.exp(-(values['horizon.limit'] / errors.sigma)**2) > EXCEEDED
        published.append(time[over][0] if over.any() else np.inf)
        nees.append(np.interp(AFTER, time, errors.nees))
    return np.column_stack([found.crossed, published, np.reshape(Terms.notes, (-1, 2 + len(KNOWN)))[:len(nees)], nees])


def withheld(recording, values: dict, predictor) -> Outages:
    """Outages of DURATION, with the horizons of `predictor`."""
    values = table.check(values)
    config, truth = FilterConfig.from_parameters(values), truth_of(recording, values)
    keep = samples_to_keep(recording.imu, truth.reference.stamp)
    aiding = Aiding(speed=recording.speed) if values['speed_topic'] else Aiding()
    started = run(config, recording.imu, recording.gnss, aiding, keep=keep).stamp
    begin = outage_begins(int(started[0]), recording.gnss, values['gnss.time_offset'], SPACING, DURATION)
    replay.HorizonPredictor = predictor
    found, = run_outages(config, recording.imu, recording.gnss, truth, [DURATION], begin, aiding, keep)
    return found


def outages_of(recording, values: dict) -> np.ndarray:
    """(o, 4 + k): announced, crossed (inf: not), how long it was looked, when half are larger, and the announcements
    with sigmas divided by NARROWER (k,), s."""
    Noted.notes.clear()
    found = withheld(recording, values, Noted)
    notes = np.reshape(Noted.notes, (-1, 1 + len(NARROWER)))[:len(found.begin)]
    at = 1  # where sigmas are divided by 1: the look that was announced, from the newest sample instead of the begin
    since = np.where(found.announced > 0.0, found.announced - notes[:, at], 0.0)
    notes = np.minimum(np.where(notes > 0.0, notes + since[:, None], 0.0), DURATION)
    return np.column_stack([np.minimum(found.announced, DURATION), found.crossed,
                            np.minimum(found.crossed, DURATION), notes])


def of_row(kind: str, name: str, seed: int, minutes: float, limit: float, data: Path, terms: bool):
    """(row of the table, outages) of one drive."""
    values, measure = {'horizon.limit': limit}, terms_of if terms else outages_of
    if name.startswith(PLAIN):
        sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
        recording = simulate_recording(simulate_drive(60.0 * minutes, seed), sensors, FIXES[name.removeprefix(PLAIN)],
                                       seed=seed).recording
        return name, measure(recording, values)
    if kind == 'simulated':
        name, _, part = name.partition(': ')
        values |= PARTS[part] if part else {}
        receiver, _, speed = name.partition(', ')
        name = f'{name}: {part}' if part else name
        return name, measure(simulated(seed, minutes, FIXES[receiver]),
                             values | ({'speed_topic': '/wheel/speed'} if speed else {}))
    folder, _, offset = name.partition(', ')
    return name, measure(measured(folder, data), {**values, **MEASURED[folder].values, **(OFFSET if offset else {})})


def line(name: str, drives: list[np.ndarray]) -> str:
    """Of the table: outages by drive."""
    blocks = drives if len(drives) > 1 else np.array_split(drives[0], max(len(drives[0]) * SPACING // DURATION, 1))
    announced, crossed, seen, half, *narrower = np.concatenate(drives).T
    later = crossed >= announced
    rng = np.random.default_rng(0)
    shares = [[np.sum(b[:, 1] >= b[:, 0]), len(b)] for b in blocks]
    drawn = np.array(shares)[rng.integers(0, len(shares), (DRAWS, len(shares)))].sum(axis=1)
    low, high = np.percentile(100 * drawn[:, 0] / drawn[:, 1], [2.5, 97.5])
    best = np.quantile(seen, 0.05) / np.median(seen)
    times = seen[announced > 0.0] / announced[announced > 0.0]
    scaled = np.quantile(times, 0.05) / np.median(times) if len(times) else np.nan
    exact = np.median(announced / np.maximum(half, 0.1))
    kept = NARROWER[[np.mean(crossed >= times) >= 0.95 for times in narrower]]
    return (f'| {name} | {len(seen)} | {100 * np.mean(np.isfinite(crossed)):.0f} % | {np.median(announced):.1f} | '
            f'{np.median(seen):.1f} | {100 * later.mean():.1f} % ({low:.0f} to {high:.0f}) | '
            f'{np.median(announced / seen):.2f} | {best:.2f} | {scaled:.2f} | {exact:.2f} | '
            f'{max(kept, default=0.0):.2g} |')


def terms_line(name: str, drives: list[np.ndarray]) -> str:
    """Of the table of --terms: outages by drive."""
    rows = np.concatenate(drives)
    count = len(rows[0]) - len(AFTER)
    shown = [f'{t:.1f}' for t in np.median(np.minimum(rows[:, :count], DURATION), axis=0)]
    nees = [f'{n / 2.0:.2f}' for n in rows[:, count:].mean(axis=0)]
    return f"| {name} | {len(rows)} | {' | '.join(shown)} | {', '.join(nees)} |"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=5)
    parser.add_argument('--first-seed', type=int, default=3000)
    parser.add_argument('--minutes', type=float, default=20.0)
    parser.add_argument('--limit', type=float, default=5.0)
    parser.add_argument('--data', type=Path, default=Path('../shared/data'))
    parser.add_argument('--processes', type=int, default=2)
    parser.add_argument('--parts', action='store_true')
    parser.add_argument('--terms', action='store_true')
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    work = [('simulated', name, seed) for name in (f'{PLAIN}1.5 m', f'{PLAIN}RTK', *FIXES,
                                                     '1.5 m, wheel speed', 'RTK, wheel speed') for seed in seeds]
    if options.terms:
        work = [('simulated', f'{receiver}{speed}', seed) for speed in ('', ', wheel speed')
                for receiver in ('1.5 m', 'RTK') for seed in seeds]
    elif options.parts:
        work = [('simulated', f'{receiver}{speed}: {part}', seed) for speed in ('', ', wheel speed')
                for receiver in ('1.5 m', 'RTK') for part in PARTS for seed in seeds]
    elif options.data.is_dir():
        work += [('measured', name, 0) for name in (*MEASURED, 'longmont_rtk_drive, time offset given')]
    results: dict[str, list[np.ndarray]] = {}
    with ProcessPoolExecutor(options.processes) as pool:
        rest = options.minutes, options.limit, options.data, options.terms
        for name, rows in pool.map(of_row, *zip(*((*w, *rest) for w in work))):
            results.setdefault(name, []).extend([rows] if len(rows) else [])
    if options.terms:
        print(f"| drive | outages | true, s | published | announced | {' | '.join(KNOWN)} | no process noise "
              f"| NEES / 2 after {', '.join(map(str, AFTER))} s |\n|{'---|' * (7 + len(KNOWN))}")
        for name, drives in results.items():
            print(terms_line(name, drives))
        return
    print('| drive | outages | crossed | announced, s | true, s | later | announced / true | best possible | scaled '
          '| exact | narrower |')
    print(f'|{"---|" * 11}')
    for name, drives in results.items():
        if drives:
            print(line(name, drives))
    everything = [rows for drives in results.values() for rows in drives]
    print(line('all', everything))


if __name__ == '__main__':
    main()
