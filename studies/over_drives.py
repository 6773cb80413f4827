"""What several studies share: simulated drives one after the other, their results by key, and a table of these."""
from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path


def main(description: str, of_drive: Callable[[int, float], list], lines: Callable[[dict, int], Iterable[str]],
         seeds: int) -> None:
    """Command line of a study.

    of_drive: (seed, minutes) -> [(key, result)] of one drive, in a process of its own. lines: of the table, from the
    results of all drives by key, (d,) each, and the number of drives. seeds: how many drives by default.
    """
    parser = argparse.ArgumentParser(description=description, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=seeds, help='number of drives')
    parser.add_argument('--first-seed', type=int, default=1000)
    parser.add_argument('--minutes', type=float, default=20.0)
    parser.add_argument('--processes', type=int, default=2)
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    results: dict = {}
    with ProcessPoolExecutor(options.processes) as pool:
        drives = range(options.first_seed, options.first_seed + options.seeds)
        for drive in pool.map(of_drive, drives, [options.minutes] * len(drives)):
            for key, result in drive:
                results.setdefault(key, []).append(result)
    text = '\n'.join(lines(results, options.seeds))
    print(text)
    if options.output:
        options.output.write_text(f'{text}\n')
