"""How the probability of a false FINE is shared out among the trials of a drive.

The k-th trial that begins has the share 6 / (pi k)^2 of FALSE_ALARMS, all of them together the whole (Bonferroni, with
weights). A trial that is proven has used nothing of its share: if its finding is true, it cannot be a false alarm. So
its share goes to the trial that begins next after it, in addition to that one's own, and so on (the fallback procedure:
B. L. Wiens, "A fixed sequence Bonferroni procedure for testing multiple endpoints", Pharmaceutical Statistics 2, 2003;
for tests that arrive one after the other J. Tian and A. Ramdas, "Online control of the familywise error rate",
Statistical Methods in Medical Research 30, 2021). To which one it goes is fixed by the order alone, whatever the
measurements are: where that trial has ended without a proof, the share is lost.
"""
from __future__ import annotations

import math
from collections.abc import Iterable

from .trial import Trial

#: probability that anything is called FINE by chance, in all the time that a filter runs
FALSE_ALARMS = 0.01


class FalseAlarms:
    """The shares of the trials of one drive. begun: how many there have been."""

    def __init__(self):
        self.begun = 0
        self._waiting = 0.0  # share for the next trial to begin
        self._passed: set[int] = set()  # numbers of trials that have passed theirs on

    def next(self) -> dict:
        """`number` and `needed` of the next trial."""
        self.begun += 1
        share, self._waiting = FALSE_ALARMS * 6.0 / (math.pi * self.begun)**2 + self._waiting, 0.0
        return {'number': self.begun, 'needed': 1.0 / share}

    def pass_on(self, trials: Iterable[Trial]) -> None:
        """Pass the shares of those `trials` on that have been proven since the last call. trials: all that go on."""
        going_on = {trial.number: trial for trial in trials}
        for number, trial in sorted(going_on.items()):
            if not trial.proven or number in self._passed:
                continue
            self._passed.add(number)
            following = number + 1
            while following in self._passed:  # it has passed on what it has, and does so with this
                following += 1
            if following > self.begun:
                self._waiting += trial.share
            elif following in going_on:
                going_on[following].add_share(trial.share)
