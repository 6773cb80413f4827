"""Compiled code calls the `observe` of the measurement whose event it is, as the registry lists them."""
from __future__ import annotations

import numpy as np
import pytest

from mems_ins_fusion.compiled import njit
from mems_ins_fusion.filter.measurements.registry import by_kind
from mems_ins_fusion.filter.memory import Event


def observing(number):
    """A compiled `observe` that writes its number, and the sum of its other arguments, to the memory."""
    @njit(_nrt=False)
    def observe(mem, r, at, h, n, c, sample):
        mem[0], mem[1] = number, r + 10 * at + 100 * h + 1000 * n + 10000 * c + 100000 * sample
        return number

    return observe


@pytest.mark.parametrize('kind, expected', [(2, 2), (3, 3), (20, 20), (7, 7), (99, 7)])
def test_the_one_of_the_events_kind_is_called(kind, expected):
    # given four kinds, the last of which observes all others, too
    observe = by_kind(tuple((number, observing(number)) for number in (2, 3, 20, 7)))

    @njit
    def called(mem, at):
        return observe(mem, 1, at, 3, 4, 5, 6)

    # when an event of one kind is observed
    at, mem = 2, np.zeros(2 + Event.SIZE)
    mem[at + Event.KIND] = kind
    components = called(mem, at)
    # then its function has all arguments in their order, and its result is returned
    assert components == mem[0] == expected
    assert mem[1] == 654321
