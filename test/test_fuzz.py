"""Whatever a file holds: a result or one line, in bounded time and memory. An hour of it: studies/fuzz.py."""
from __future__ import annotations

from fuzz_support import cases, outcome

#: number of cases: two or three of each kind of file
CASES = 60


def test_spoiled_input_gives_a_result_or_one_line(tmp_path):
    complaints = []
    for _, (name, work) in zip(range(CASES), cases(tmp_path, 0)):
        found = outcome(work).complaint()
        if found:
            complaints.append(f'{name}: {found}')
    assert not complaints, '\n'.join(complaints)
