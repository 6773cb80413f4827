"""A small memory for a copy of a filter that begins with its newest state and cannot return to an earlier one.

It has the head of the filter's memory (memory.py), a few rows for states, some IMU samples, measurements, and the
scratch: some kilobytes instead of megabytes.
"""
from __future__ import annotations

import numpy as np

from ..bank import Bank
from ..config import FilterConfig
from ..measurements.wheel_vibration import Wheels
from ..memory import NEWEST, Event, Head, Sample, sample_at, scratch_size, state_at

#: s, step of such a filter: constraints have the same weight at this interval as at CONSTRAINT_INTERVAL
#: (`constraints.LARGEST_DIVISOR`)
STEP = 0.2


class NewestState:
    """Small memory for filters with `config`: `rows` states, `samples` IMU samples and `events` measurements."""

    def __init__(self, config: FilterConfig, rows: int, samples: int, events: int):
        memory = config.memory()
        self._first, self._width = int(memory[Head.ROWS_AT]), int(memory[Head.WIDTH])
        ring = self._first + rows * self._width
        at = ring + samples * Sample.SIZE
        scratch = at + events * Event.SIZE
        self.memory = np.zeros(scratch + scratch_size(config.layout.n))
        self._head = {Head.CAPACITY: NEWEST, Head.EVENT_CAPACITY: events, Head.SAMPLES: 0, Head.EVENTS: 0,
                      Head.RING_AT: ring, Head.EVENTS_AT: at, Head.SCRATCH_AT: scratch, Head.HISTORY_AT: 0,
                      Wheels.AT: 0, Bank.SIZE: 0, Bank.OPEN: 0}

    def take(self, memory: np.ndarray) -> np.ndarray:
        """Begin with the newest state and sample of the filter with `memory`, as number 0; returns the small memory."""
        mine, newest = self.memory, int(memory[Head.SAMPLES])
        mine[:self._first] = memory[:self._first]
        for column, value in self._head.items():
            mine[column] = value
        state, sample = state_at(memory, newest), sample_at(memory, newest)
        mine[self._first:][:self._width] = memory[state:state + self._width]
        mine[int(mine[Head.RING_AT]):][:Sample.SIZE] = memory[sample:sample + Sample.SIZE]
        return mine
