"""How often bets prove a finding that is no better, where errors that both filters have in common last for outages.

    python studies/online_lasting_errors.py [--trials 100] [--first-seed 0] [--minutes 20] [--processes 2]

No filters: two predictions, 45 outages of 1 s a minute. Both are off by the same error of 4 cm, and the side on which
the other one lies lasts for outages, too; they are 2 cm apart, and 30 cm in one outage in fifteen, as in a turn. By how
far errors last (correlation from one outage to the next), by bets on each outage and on blocks of them (as in a trial),
with all differences and with clear ones alone: the share of trials that ever come to the wealth of the first finding
where the truth is in the middle of both predictions in the mean, and where it is what the other one predicts, with the
median time in minutes.
"""
from __future__ import annotations

import argparse
import math
from concurrent.futures import ProcessPoolExecutor
from functools import partial

import numpy as np

from mems_ins_fusion.diagnosis.false_alarms import FALSE_ALARMS
from mems_ins_fusion.diagnosis.trial import STAKED, UNSTAKED
from mems_ins_fusion.filter.runs.betting import Bets

OUTAGES = 45  # in a minute
COMMON, OWN, NEAR, FAR = 0.04, 0.02, 0.02, 0.3  # m: errors in common, of each outage; how far predictions are apart
TURNING = 1.0 / 15.0  # part of the outages in turns
CORRELATIONS = (0.0, 0.9, 0.98)  # of errors from one outage to the next
SIDES = 0.95  # correlation of the side from one outage to the next
NEEDED = math.pi**2 / (6.0 * FALSE_ALARMS)


#: a bet on each outage, on blocks of them
BETS = (0, math.ceil(UNSTAKED))


def proven(case: tuple[float, float, bool, int], minutes: int, seed: int) -> float:
    """Minutes until a trial comes to the wealth that it needs, staked in parts as `trial.Trial` does; inf: never.

    case: of `Bets` how clear differences have to be, correlation of the errors, whether the other prediction is right,
    and outages before the first stake.
    """
    clear, lasting, right, first = case
    rng, bets, common, side = np.random.default_rng(seed), Bets(clear, first), 0.0, 0.0
    bets.pro = -math.inf
    for minute in range(1, minutes + 1):
        bets.pro = float(np.logaddexp(bets.pro, -math.log(minute * (minute + 1))))
        for _ in range(OUTAGES):
            common = lasting * common + math.sqrt(1.0 - lasting**2) * COMMON * rng.standard_normal()
            side = SIDES * side + math.sqrt(1.0 - SIDES**2) * rng.standard_normal()
            apart = rng.exponential(FAR) if rng.random() < TURNING else NEAR * abs(side)
            error, half = common + OWN * rng.standard_normal(), math.copysign(0.5 * apart, side)
            error += half if right else 0.0
            bets.take((error + half, 0.0), (error - half, 0.0))
            if math.exp(bets.pro) + 1.0 / (minute + 1) >= NEEDED:
                return float(minute)
    return math.inf


def cell(times: list[float]) -> str:
    """Of the table."""
    share = float(np.mean(np.isfinite(times)))
    return f'{100.0 * share:.0f} %' + (f', {np.median(times):.0f} min' if share > 0.5 else '')


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--trials', type=int, default=100)
    parser.add_argument('--first-seed', type=int, default=0)
    parser.add_argument('--minutes', type=int, default=20)
    parser.add_argument('--processes', type=int, default=2)
    options = parser.parse_args()
    seeds = range(options.first_seed, options.first_seed + options.trials)
    print('| truth | correlation | each outage | blocks | each clear difference | blocks, clear differences |\n'
          '|---|---|---|---|---|---|')
    with ProcessPoolExecutor(options.processes) as pool:
        for right, lasting in ((right, lasting) for right in (False, True) for lasting in CORRELATIONS):
            cells = [cell(list(pool.map(partial(proven, (clear, lasting, right, first), options.minutes), seeds,
                                        chunksize=10))) for clear in STAKED for first in BETS]
            print(f"| {'as the other one predicts' if right else 'in the middle'} | {lasting:g} | "
                  f"{' | '.join(cells)} |", flush=True)


if __name__ == '__main__':
    main()
