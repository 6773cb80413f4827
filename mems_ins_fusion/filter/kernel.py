"""The compiled filter: one error-state Kalman filter for the live node and for the replay of whole recordings.

All of it lives in one flat array of floats (`FilterConfig.memory` lays it out): a head with sizes and settings, the
noise of each state, a ring of the latest states (rows, see memory.py), a ring of the IMU samples between them, and the
measurements of the same time. Because the ring remembers, a measurement that comes late is applied at its own time:
back to the state before it and forward again. A copy of the memory is a second filter (outages are branched off so).

`run` is the one way in: live it is called with one event at a time, offline with a whole recording. It is the same
compiled code, so both give the same bits.
"""
from __future__ import annotations

import numpy as np

from mems_ins_fusion.compiled import njit

from .advance import take_event, take_sample
from .bank import Bank, compare
from .memory import Event, Head, event_at, state_at


@njit(_nrt=False)
def find_event(memory, identity):
    """Position of the measurement with this Event.ID, the newest first; -1: it is not remembered."""
    for i in range(int(memory[Head.EVENTS]) - 1, -1, -1):
        if memory[event_at(memory, i) + Event.ID] == identity:
            return event_at(memory, i)
    return -1


@njit(nogil=True, _nrt=False)
def run(memory, samples, events, arrival, answers, columns, kept, states, log):
    """IMU samples and measurements in the order of their arrival through the filter.

    samples (k, 7): time (s since the epoch), specific force and angular rate in sensor axes. events (e, Event.SIZE) in
    the order of their arrival; arrival (e,): the number of `samples` that arrived before each; answers (e,): TAKEN, or
    why not. kept (s,): indices of samples, ascending, after which the columns `columns` of the newest state, as a live
    filter publishes it, go into states (s, len(columns)). log: rows by Event.ID into which measurements go back with
    what came of them, before they are forgotten; empty: none.
    """
    next_event, next_row, other = 0, 0, memory[int(memory[Bank.SIZE]):]
    for k in range(len(samples) + 1):
        while next_event < len(events) and arrival[next_event] <= k:
            if memory[Head.EVENTS] == memory[Head.EVENT_CAPACITY] and len(log):
                collect(memory, log)
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
def collect(memory, log):
    """What came of the measurements remembered, to the rows of `log` that their IDs name."""
    for i in range(int(memory[Head.EVENTS])):
        at = event_at(memory, i)
        row = int(memory[at + Event.ID])
        for c in range(Event.SIZE):
            log[row, c] = memory[at + c]
