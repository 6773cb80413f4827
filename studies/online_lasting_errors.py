"""How often bets prove a finding that is no better, where errors that both filters have in common last for outages.

    python studies/online_lasting_errors.py [--trials 100] [--minutes 20]

No filters: two predictions with the truth in their middle in the mean, 45 outages of 1 s a minute. Both are off by the
same error of 4 cm, and the side on which the other one lies lasts for outages, too; they are 2 cm apart, and 30 cm in
one outage in fifteen, as in a turn. By how far both errors and sides last (correlation from one outage to the next):
the share of trials that ever come to the wealth of the first finding, by bets on each outage and by those on clear
differences alone.
"""
from __future__ import annotations

import argparse
import math

import numpy as np

from mems_ins_fusion.diagnosis.online import FALSE_ALARMS
from mems_ins_fusion.diagnosis.trial import STAKED
from mems_ins_fusion.filter.runs.betting import Bets

OUTAGES = 45  # in a minute
COMMON, OWN, NEAR, FAR = 0.04, 0.02, 0.02, 0.3  # m: errors in common, of each outage; how far predictions are apart
TURNING = 1.0 / 15.0  # part of the outages in turns
SIDES = 0.95  # correlation of the side from one outage to the next
NEEDED = math.pi**2 / (6.0 * FALSE_ALARMS)


def proven(clear: float, lasting: float, minutes: int, seed: int) -> bool:
    """Whether a trial ever comes to the wealth that it needs, staked in parts as `trial.Trial` does."""
    rng, bets, common, side = np.random.default_rng(seed), Bets(clear), 0.0, 0.0
    bets.pro = -math.inf
    for minute in range(1, minutes + 1):
        bets.pro = float(np.logaddexp(bets.pro, -math.log(minute * (minute + 1))))
        for _ in range(OUTAGES):
            common = lasting * common + math.sqrt(1.0 - lasting**2) * COMMON * rng.standard_normal()
            side = SIDES * side + math.sqrt(1.0 - SIDES**2) * rng.standard_normal()
            apart = rng.exponential(FAR) if rng.random() < TURNING else NEAR * abs(side)
            error, half = common + OWN * rng.standard_normal(), math.copysign(0.5 * apart, side)
            bets.take((error + half, 0.0), (error - half, 0.0))
            if math.exp(bets.pro) + 1.0 / (minute + 1) >= NEEDED:
                return True
    return False


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--trials', type=int, default=100)
    parser.add_argument('--minutes', type=int, default=20)
    options = parser.parse_args()
    print('| correlation | bets on each outage | on clear differences |\n|---|---|---|')
    for lasting in (0.0, 0.9, 0.98):
        shares = [np.mean([proven(clear, lasting, options.minutes, seed) for seed in range(options.trials)])
                  for clear in STAKED]
        print(f"| {lasting:g} | {' | '.join(f'{100.0 * share:.0f} %' for share in shares)} |", flush=True)


if __name__ == '__main__':
    main()
