"""Parts of the data that are held out in turn: blocks of time of each drive; of three drives and more, whole drives."""
from __future__ import annotations

import numpy as np

from .drives import Drives
from .problem import Problem

PARTS = 4  # number of parts of a recording
BLOCKS = 2  # number of blocks of time in each part, so that it contains more than one road
SHORTEST_BLOCK = 30.0  # s, shortest block: a filter needs some seconds of each to converge
FEWEST_DRIVES = 3  # smallest number of drives that are held out as wholes


def part_masks(problem: Problem | Drives) -> list[np.ndarray]:
    """Masks (f,) of the fixes of each part, within the mask of the problem."""
    if len(problem.each) < FEWEST_DRIVES:
        return [np.concatenate(same) for same in zip(*(_blocks(p) for p in problem.each))]
    return [np.concatenate([p.mask & (p is drive) for p in problem.each]) for drive in problem.each]


def _blocks(problem: Problem) -> list[np.ndarray]:
    """Masks of the parts of one drive; blocks of time go to the parts in turn, so that all have all kinds of road."""
    stamp = problem.stamp[problem.mask]
    duration = (stamp[-1] - stamp[0]) * 1e-9
    length = max(duration / (PARTS * BLOCKS), min(SHORTEST_BLOCK, duration / PARTS)) + 1e-6
    part = part_of(problem.stamp, stamp[0], length)
    return [problem.mask & (part == k) for k in range(PARTS)]


def which_part(problem: Problem):
    """A function that returns the index in `part_masks`, -1 for none, for stamps (k,) ns."""
    masks = part_masks(problem)

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
    """(k,) bool: whether the last fix before each stamp (ns) is in `mask`."""
    at = np.clip(np.searchsorted(problem.stamp, stamp, side='right') - 1, 0, len(mask) - 1)
    return mask[at]
