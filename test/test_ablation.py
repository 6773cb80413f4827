"""The ablation study changes constants by name, in each module that has them, and finds them all."""
from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def said(script, interpreted='1'):
    environment = {**os.environ, 'PYTHONPATH': f"{ROOT}:{ROOT / 'studies'}", 'NUMBA_DISABLE_JIT': interpreted}
    return subprocess.run([sys.executable, '-c', script], env=environment, capture_output=True, text=True,
                          check=True).stdout.split()


def test_a_constant_is_changed_wherever_it_is_used():
    # given one that another module has imported, and one of a tuple
    assert said("""
from mems_ins_fusion.filter import bank, prediction
from mems_ins_fusion.filter.trust import new_start
from ablation import lay_over
lay_over({'prediction.GAP_ACCELERATION': 9.0, 'bank.EARLIER[1]': 0.5})
print(prediction.GAP_ACCELERATION, new_start.GAP_ACCELERATION, *bank.EARLIER)
""") == ['9.0', '9.0', '0.0', '0.5', '4.0', '8.0']


def test_compiled_code_finds_the_value_that_a_constant_has_now():
    # given a scale of e^-3 whose logarithm has the prior as its variance: all but one sigma of it counts
    assert said("""
import numpy as np
from ablation import constants, lay_over
from mems_ins_fusion.filter.trust import scale
lay_over(constants())
for prior in 4.0, 1.0, 4.0:
    lay_over({'trust.scale.PRIOR': prior})
    print(round(np.log(scale.scale(np.array([-3.0, 0.0]), 0)), 9))
""", interpreted='0') == ['-1.0', '-2.0', '-1.0']


def test_what_is_compared_with_the_filter_as_it_is():
    # given a change that moves nothing, one that doubles one of two calm rows and a chaotic one, and one that ends in a
    # division by zero
    lines = said("""
from ablation import summary
rows = [{'change': c, 'row': r, 'rate_hz': rate, 'error_m': e, 'within_95_percent': w} for c, r, rate, e, w in (
    ('as it is', 'r', '1', '5.0', '95'), ('as it is', 'r', '10', '4.0', '95'), ('as it is', 'boat', '1', '2.0', '95'),
    ('a x 4', 'r', '1', '5.01', '95'), ('a x 4', 'r', '10', '4.0', '95'), ('a x 4', 'boat', '1', '2.0', '95'),
    ('b x 4', 'r', '1', '10.0', '93'), ('b x 4', 'r', '10', '4.0', '95'), ('b x 4', 'boat', '1', '900.0', '95'),
    ('c x 4', 'as it is', '0', 'inf', '0'))]
print('|'.join(summary(rows)).replace(' ', '_'))
""")[0].split('|')
    # then the mean is that of the calm rows
    assert lines[0].endswith(';_2_at_1_Hz,_0_at_10_Hz;_mean_+41.4_%,_in_the_ellipse_-1.00_%')
    assert lines[1:] == ['move_nothing:_a_x_4', 'impossible_(division_by_zero):_c_x_4']
