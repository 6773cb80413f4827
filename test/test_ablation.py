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
    assert said("""
from ablation import summary
rows = [{'change': c, 'row': 'r', 'rate_hz': '1.0', 'error_m': e, 'within_95_percent': '95'}
        for c, e in (('as it is', '5.0'), ('a x 4', '5.01'), ('b x 4', '7.0'))]
print(summary(rows)[-1].replace(' ', '_'), len(summary(rows)))
""") == ['move_nothing:_a_x_4', '2']
