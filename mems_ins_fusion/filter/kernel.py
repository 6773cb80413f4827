"""The compiled filter: one error-state Kalman filter for the live node and for the replay of whole recordings.

The filter is one flat array of floats (`FilterConfig.memory`): a head with sizes and settings, noise parameters, the
latest states and some earlier ones (rows, see memory.py), a ring of the IMU samples between them, and the measurements
of the same period. A late measurement is applied at its own time: the filter returns to the last state before it that
is kept, and repeats the samples and measurements that followed. A copy of the array is an independent filter; replayed
outages use copies.

`run` is the only entry point. The live node calls it with one sample or measurement at a time, a replay with a whole
recording. Both execute the same compiled code, so the results are the same to the last bit.
"""
from __future__ import annotations

import math

import numpy as np

from mems_ins_fusion.compiled import njit

from .advance import take_event, take_sample
from .bank import Bank, compare
from .memory import Event, Head, Kind, Nav, copy, event_at, state_at


@njit(_nrt=False)
def find_event(memory, identity):
    """Position in `memory` of the measurement with this Event.ID; -1: it is no longer there. The newest come first."""
    for i in range(int(memory[Head.EVENTS]) - 1, -1, -1):
        if memory[event_at(memory, i) + Event.ID] == identity:
            return event_at(memory, i)
    return -1


@njit(nogil=True, _nrt=False)
def run(memory, samples, events, arrival, answers, columns, kept, states, log):
    """Process IMU samples and measurements in the order of their arrival.

    samples (k, 7): time (s since the filter's epoch), specific force (m/s^2) and angular rate (rad/s) in sensor axes;
    (k, 13) of several IMUs: then the difference of two of them (`ImuSamples.difference`).
    events (e, Event.SIZE): measurements in the order of arrival. arrival (e,): number of samples that arrived before
    each measurement. answers (e,), output: for each measurement TAKEN or the reason why it was not (advance.py).
    kept (s,): ascending indices of samples. After each of these, the `columns` of the newest state are written to
    states (s, len(columns)), output. log (measurements, Event.SIZE), output: each measurement with its result, in the
    row of its Event.ID; an empty array: none is written.
    """
    next_event, next_row, other = 0, 0, memory[int(memory[Bank.SIZE]):]
    for k in range(len(samples) + 1):
        while next_event < len(events) and arrival[next_event] <= k:
            if memory[Head.EVENTS] == memory[Head.EVENT_CAPACITY] and len(log):
                collect(memory, log)
            _turn_longitude(memory, events, next_event)
            answers[next_event] = take_event(memory, events, next_event)
            if memory[Bank.OPEN] != 0.0:
                take_event(other, events, next_event)
            compare(memory)
            next_event += 1
        if k == len(samples):
            break
        take_sample(memory, samples, k)
        if memory[Bank.OPEN] != 0.0:
            take_sample(other, samples, k)
        compare(memory)
        if next_row < len(kept) and kept[next_row] == k:
            newest = np.uint64(state_at(memory, int(memory[Head.SAMPLES])))
            for c in range(len(columns)):
                states[next_row, c] = memory[newest + columns[c]]
            next_row += 1
    if len(log) and len(samples):
        collect(memory, log)


@njit(_nrt=False)
def _turn_longitude(memory, events, i):
    """Add full turns to the longitude of fix i until it is within 180 degrees of the state's, which is continuous
    across the antimeridian."""
    if events[i, Event.KIND] == Kind.POSITION or events[i, Event.KIND] == Kind.PLACE:
        ahead = events[i, Event.LONGITUDE] - memory[state_at(memory, int(memory[Head.SAMPLES])) + Nav.LONGITUDE]
        events[i, Event.LONGITUDE] -= 2.0 * math.pi * np.round(ahead / (2.0 * math.pi))


@njit(_nrt=False)
def collect(memory, log):
    """Copy the measurements in the memory, with their results, to the rows of `log` by Event.ID."""
    for i in range(int(memory[Head.EVENTS])):
        at = event_at(memory, i)
        copy(log[int(memory[at + Event.ID])], 0, memory, at, Event.SIZE)
