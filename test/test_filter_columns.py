"""Where mechanisms remember what they remember: columns that each asks for, placed behind one another."""
from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from filter_support import configure, newest, started

from mems_ins_fusion.filter.columns import Part
from mems_ins_fusion.filter.memory import (
    HEAD,
    INPUT,
    INPUT_SIZE,
    NAV,
    PLANAR,
    ROW,
    SAMPLE,
    STRAPDOWN,
    StateLayout,
    covariance,
    covariance_index,
    row_width,
    set_covariance,
)
from mems_ins_fusion.filter.trust.drift import Drift


def test_columns_are_placed_behind_one_another_and_begin_with_their_first_values():
    part = Part('a part', 10, 20)
    first, second = part.place('First', A=1, B=(2, 1.5)), part.place('Second', C=3)
    assert (first.A, first.B, second.C) == (10, 11, 13)
    row = np.zeros(20)
    part.begin(row)
    assert row[10:16].tolist() == [0.0, 1.5, 1.5, 0.0, 0.0, 0.0]


def test_a_part_that_is_full_says_who_found_no_room():
    part = Part('a part', 0, 3)
    part.place('First', A=2)
    with pytest.raises(IndexError, match='a part: no room for Second, 1 floats too few'):
        part.place('Second', A=2)


@pytest.mark.parametrize('part', [ROW, HEAD, SAMPLE, INPUT], ids=lambda part: part.name)
def test_the_files_of_the_filter_need_all_the_room_that_is_there(part):
    assert part.next == part.end


@pytest.mark.parametrize('module', ['trust.drift', 'trust.lag', 'memory', 'runs.live'])
def test_they_are_the_same_whatever_is_imported_first(module):
    # given that compiled code is kept with these positions in it
    script = (f'import mems_ins_fusion.filter.{module}\n'
              'from mems_ins_fusion.filter.trust import drift, imu_faults, lag, standstill, white_noise\n'
              'print(*drift.Drift, *imu_faults.Imu, *lag.Lag, *standstill.Still, *white_noise.Shown)')
    places = {subprocess.run([sys.executable, '-c', s], capture_output=True, text=True, check=True).stdout
              for s in (script, script.split('\n', 1)[1])}
    assert len(places) == 1


@pytest.mark.parametrize('mechanization', ['planar', 'strapdown'])
def test_a_state_begins_with_them(mechanization):
    row = newest(started(configure(mechanization=mechanization)))
    assert row[[Drift.RATIO, Drift.RATIO + 1]].tolist() == [1.0, 1.0] and row[Drift.TIME] == 0.0


@pytest.mark.parametrize(('mechanization', 'order', 'inputs'), [(PLANAR, 1, 0), (PLANAR, 2, 1), (STRAPDOWN, 1, 2),
                                                                (STRAPDOWN, 3, 0)])
def test_a_covariance_comes_back_as_it_was_and_each_element_stands_where_it_is_looked_for(mechanization, order, inputs):
    # given a covariance that is symmetric but for its last digits, as products of matrices are
    layout = StateLayout(mechanization, order, ('coloured_n', 'coloured_e'), inputs)
    root = np.random.default_rng(3).standard_normal((layout.n, layout.n))
    given = root @ root.T + 1e-15 * root
    # when it is written to a state
    row = np.zeros(row_width(layout))
    set_covariance(row, layout, given)
    # then it is that above the diagonal, and nothing else of the state has changed
    read = covariance(row, layout)
    assert np.array_equal(np.triu(read), np.triu(given)) and np.array_equal(read, read.T)
    places = np.array([[covariance_index(i, j, layout) for j in range(layout.n)] for i in range(layout.n)])
    assert np.array_equal(row[places], read)
    begin, end = NAV + layout.n, len(row) - INPUT_SIZE * inputs
    assert not row[:begin].any() and not row[end:].any() and (places.min(), places.max()) == (begin, end - 1)
