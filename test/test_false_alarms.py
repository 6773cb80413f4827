"""How the probability of a false alarm is shared out among trials."""
from __future__ import annotations

import math

import pytest
from test_online import finding

from mems_ins_fusion.diagnosis.false_alarms import FALSE_ALARMS, FalseAlarms
from mems_ins_fusion.diagnosis.trial import Trial


def share(k):
    """Of the k-th trial, where none is proven."""
    return FALSE_ALARMS * 6.0 / (math.pi * k) ** 2


def begun(alarms, count):
    return [Trial(finding(), {}, **alarms.next()) for _ in range(count)]


def test_all_shares_together_are_the_whole():
    alarms = FalseAlarms()
    trials = begun(alarms, 4)
    assert [trial.number for trial in trials] == [1, 2, 3, 4] and alarms.begun == 4
    assert [trial.needed for trial in trials] == pytest.approx([1.0 / share(k) for k in (1, 2, 3, 4)])
    assert sum(share(k) for k in range(1, 100_000)) == pytest.approx(FALSE_ALARMS, rel=1e-4)


def test_what_is_proven_passes_its_share_on_once():
    # given a trial that is proven while the next one goes on
    alarms = FalseAlarms()
    first, second, third = begun(alarms, 3)
    first.proven = True
    alarms.pass_on([first, second, third]), alarms.pass_on([first, second, third])
    assert 1.0 / second.needed == pytest.approx(share(1) + share(2)) and 1.0 / third.needed == pytest.approx(share(3))
    # then that one passes both on
    second.proven = True
    alarms.pass_on([first, second, third])
    assert 1.0 / third.needed == pytest.approx(share(1) + share(2) + share(3))
    # and the last one to the one that begins next
    third.proven = True
    alarms.pass_on([first, second, third])
    assert alarms.next()['needed'] == pytest.approx(1.0 / sum(share(k) for k in (1, 2, 3, 4)))
    assert alarms.next()['needed'] == pytest.approx(1.0 / share(5))


def test_a_share_goes_past_what_has_been_proven_before():
    alarms = FalseAlarms()
    first, second, third = begun(alarms, 3)
    second.proven = True
    alarms.pass_on([first, second, third])
    first.proven = True
    alarms.pass_on([first, second, third])
    assert 1.0 / third.needed == pytest.approx(share(1) + share(2) + share(3))


def test_the_share_of_a_trial_that_has_ended_is_lost():
    # given a second trial that has been replaced by a third one
    alarms = FalseAlarms()
    first, _, third = begun(alarms, 3)
    first.proven = True
    alarms.pass_on([first, third])
    # then which trial gets a share does not depend on which ones were given up
    assert 1.0 / third.needed == pytest.approx(share(3))
    assert 1.0 / alarms.next()['needed'] == pytest.approx(share(4))


def test_what_a_trial_has_lost_is_needed_in_addition_with_a_larger_share_too():
    alarms = FalseAlarms()
    first, second = begun(alarms, 2)
    second.needed *= 2.0  # it had half of its wealth when it began anew
    first.proven = True
    alarms.pass_on([first, second])
    assert 1.0 / second.needed == pytest.approx(0.5 * (share(1) + share(2)))
