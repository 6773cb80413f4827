"""Change points found: steps of some sigmas of one drive, in fleets of eight vehicles; and what it finds wrongly.

    python studies/fleet_change_points.py

Each row: 60 simulated series of estimates, of one quantity, with one step in one vehicle after 3 of 5 drives; found is
one between the right two drives. Then fleets in which nothing changed.
"""
from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'test'))
from fleet_support import estimates  # noqa: E402

from mems_ins_fusion.fleet.change_points import find_changes, series_of  # noqa: E402

FLEETS, SIGMA = 60, 0.04


def found(rng, drives: int, step: float) -> float:
    """Share of the steps of `step` sigmas that are found where they are."""
    first = int(0.6 * drives)
    hits = 0
    for _ in range(FLEETS):
        rows = estimates(rng, 8, drives, SIGMA, step=(2, first, step * SIGMA))
        hits += any((c.vehicle, c.drives[0]) == ('car_2', first) for c in find_changes(series_of(rows)))
    return hits / FLEETS


def wrong(rng, vehicles: int, drives: int, realised: float, scatters: float = 1.0) -> float:
    """Share of the fleets with a change where there is none. realised: of stated sigmas; scatters: of one vehicle's."""
    hits = 0
    for _ in range(FLEETS):
        rows = estimates(rng, vehicles, drives, SIGMA, realised)
        for row in rows:
            if row['vehicle'] == 'car_0':
                row['value'] += SIGMA * np.sqrt(scatters**2 - 1) * rng.standard_normal()
        hits += bool(find_changes(series_of(rows)))
    return hits / FLEETS


def main() -> None:
    rng = np.random.default_rng(1)
    for drives in (5, 10, 20):
        print(f'{drives} drives:', ', '.join(f'{step:g} sigmas {100 * found(rng, drives, step):.0f} %'
                                             for step in (3.0, 4.0, 5.0, 6.0, 8.0, 10.0)), flush=True)
    for vehicles, drives, realised, scatters in ((8, 5, 1.0, 1.0), (8, 5, 4.0, 1.0), (1, 12, 3.0, 1.0),
                                                 (30, 10, 1.5, 1.0), (8, 5, 1.0, 7.0), (8, 12, 1.0, 7.0)):
        share = wrong(rng, vehicles, drives, realised, scatters)
        print(f'{vehicles} vehicles, {drives} drives, sigmas realised {realised:g}-fold, of one {scatters:g}-fold: '
              f'{100 * share:.0f} % with a false one', flush=True)


if __name__ == '__main__':
    main()
