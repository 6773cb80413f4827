"""The filter's numbers on short drives are those of numbers.csv: a change is meant, and seen in review."""
from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / 'studies'))
from table_of_numbers import CASES, differences, numbers_of, written  # noqa: E402


@pytest.mark.parametrize('case', CASES)
def test_the_numbers_are_those_of_the_table(case):
    # given the table of the last `python studies/table_of_numbers.py --write`
    table = {key: value for key, value in written().items() if key[0] == case}
    # then the code gives the same, to rounding
    new = [(case, quantity, value) for quantity, value in numbers_of(case).items()]
    assert not differences(table, new), '\n' + '\n'.join(differences(table, new))


def test_the_table_holds_these_cases_and_no_other():
    assert {case for case, _ in written()} == set(CASES)


def test_a_changed_number_is_named_with_old_and_new():
    table = {('a', 'x'): 1.0, ('a', 'y'): 2.0, ('a', 'gone'): 3.0}
    lines = differences(table, [('a', 'x', 1.0 + 1e-12), ('a', 'y', 2.0 + 1e-7), ('a', 'new', 4.0)])
    assert [line.split() for line in lines] == [['a', 'y', '2', '->', '2.0000001'], ['a', 'new', 'nan', '->', '4'],
                                                ['a', 'gone', '3', '->', 'none']]
