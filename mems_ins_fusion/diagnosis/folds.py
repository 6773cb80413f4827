"""Parts of the data, each held out in turn: blocks of time of each drive, or, of three drives and more, the drives."""
from __future__ import annotations

import numpy as np

from .drives import Drives
from .problem import Problem

#: parts of a recording, each of which is held out in turn
PARTS = 4
#: blocks of each part, so that it is not of one road alone
BLOCKS = 2
#: s, of a block at least: a filter needs some seconds of each to find its state
SHORTEST_BLOCK = 30.0
#: drives from which on each is held out as a whole
FEWEST_DRIVES = 3


def parts(problem: Problem | Drives) -> list[np.ndarray]:
    """Masks of the fixes that count, by part: whole drives where there are enough; else parts of each."""
    if len(problem.each) < FEWEST_DRIVES:
        return [np.concatenate(same) for same in zip(*(_blocks(p) for p in problem.each))]
    return [np.concatenate([p.mask & (p is drive) for p in problem.each]) for drive in problem.each]


def _blocks(problem: Problem) -> list[np.ndarray]:
    """Parts of one drive: blocks of time in turns, so that all parts see all kinds of road."""
    stamp = problem.stamp[problem.mask]
    duration = (stamp[-1] - stamp[0]) * 1e-9
    length = max(duration / (PARTS * BLOCKS), min(SHORTEST_BLOCK, duration / PARTS)) + 1e-6
    part = part_of(problem.stamp, stamp[0], length)
    return [problem.mask & (part == k) for k in range(PARTS)]


def which_part(problem: Problem):
    """A function that tells the part, by its place in `parts`, of stamps (k,) ns."""
    masks = parts(problem)

    def of(stamp):
        found = np.full(len(stamp), -1)
        for k, mask in enumerate(masks):
            found[in_mask(stamp, problem, mask)] = k
        return found
    return of


def part_of(stamp: np.ndarray, origin: int, length: float) -> np.ndarray:
    """0 to PARTS - 1 for each stamp (ns), by blocks of `length` s from `origin` on."""
    return np.floor((stamp - origin) * 1e-9 / length).astype(np.int64) % PARTS


def in_mask(stamp: np.ndarray, problem: Problem, mask: np.ndarray) -> np.ndarray:
    """Which stamps (ns) lie in the blocks of `mask`: those whose latest fix does."""
    at = np.clip(np.searchsorted(problem.stamp, stamp, side='right') - 1, 0, len(mask) - 1)
    return mask[at]
