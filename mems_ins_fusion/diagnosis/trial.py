"""A finding on trial: what outages after it say for it and against it, its state, and how that is told."""
from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..filter.runs.betting import CLEAR, Bets
from ..parameters.params_file import yaml_value
from .advice import WORTH, Advice
from .findings import Finding
from .quantity import COARSE, FINE, SUSPECT, Kept, Quantity
from .trial_outages import OUTAGES, Place

#: outages in which what is applied and does good is taken back once at most: a day of the shortest ones
TAKEN_BACK = 86_400.0
#: wealth against it in outages of one duration with which nothing is proven: what follows the errors of the fixes, and
#: so predicts the next one, predicts worse over half a minute. With as much in all outages it is taken back where the
#: last minutes show another value: then it takes both to be wrong by chance. An antenna shows in turns alone, and one
#: or two turns after it has been moved do not reach TAKEN_BACK
DOUBTED = 20.0
#: of the bets on one duration: those on each outage add up what is seen of small differences (fixes of metres), those
#: on clear ones alone lose nothing on a straight road
STAKED = (0.0, CLEAR)
#: s without fixes, of each duration, before the first stake: errors that last for seconds have shown that by then
UNSTAKED = 30.0
#: of a parameter in a line to copy
DIGITS = 5


@dataclass
class Trial:
    """A finding on trial. sets: parameters as it would have them. needed: wealth with which it is proven. number: the
    how many-th trial of the drive. share: probability of proving it by chance (`false_alarms.py`).

    applied: whether it is part of the parameters that drive. harmful: it was, and has been taken back. seen: whether no
    later analysis speaks against it. kept: for the next drive, where it is applied. advice: what would show more of it.
    errors: by duration, m, without it and with it in each outage. bets: by duration, and by how far the predictions
    have to be apart (`betting.CLEAR`), for it with what came in until now: of the wealth 1 that a trial begins with,
    1 / (k (k + 1)) comes into the bets with the k-th chunk. So what is lost on a straight road, where the state of
    either filter decides by chance, need not be won again in the next turn; and as no wealth is made by that, what
    chance proves stays as seldom. taken: chunks.
    """

    finding: Finding
    sets: dict
    needed: float
    applied: bool = False
    proven: bool = False
    harmful: bool = False
    seen: bool = True
    kept: Kept | None = None
    advice: Advice | None = None
    errors: dict[float, list[tuple[float, float]]] = field(default_factory=lambda: {d: [] for d in OUTAGES})
    bets: dict[tuple[float, float], Bets] = field(default_factory=lambda: {
        (d, clear): _without_wealth(Bets(clear, math.ceil(UNSTAKED / d))) for d in OUTAGES for clear in STAKED})
    taken: int = 0
    number: int = 0
    share: float = field(init=False)

    def __post_init__(self):
        self.share = 1.0 / self.needed

    @property
    def wealth(self) -> float:
        """For the finding: of all bets, in equal parts, and what has not come into them yet."""
        return 1.0 / (self.taken + 1) + float(np.mean([np.exp(bets.pro) for bets in self.bets.values()]))

    @property
    def harm(self) -> float:
        """Against it."""
        return float(np.mean([np.exp(bets.con) for bets in self.bets.values()]))

    @property
    def doubted(self) -> bool:
        """Whether outages of any duration speak against it."""
        return any(np.mean([np.exp(self.bets[d, clear].con) for clear in STAKED]) >= DOUBTED for d in OUTAGES)

    @property
    def rejected(self) -> bool:
        if self.applied:
            return self.harm >= (TAKEN_BACK if self.seen else DOUBTED)
        return self.harmful or (not self.proven and self.harm >= self.needed)

    @property
    def state(self) -> str:
        if self.proven:
            return FINE if self.seen else SUSPECT
        return SUSPECT if self.applied or self.rejected or not self.seen else COARSE

    def take(self, errors: dict[float, list[tuple[Place, Place]]], now: int = 0) -> None:
        """What the outages of one more chunk say, by duration: how far the fixes were from either filter, m. now: ns,
        its end."""
        before = self.proven
        self.taken += 1
        for bets in self.bets.values():
            bets.pro = float(np.logaddexp(bets.pro, -math.log(self.taken * (self.taken + 1))))
        for duration in OUTAGES:
            for without, with_it in errors[duration]:
                self.errors[duration].append((float(np.hypot(*without)), float(np.hypot(*with_it))))
                for bets in (self.bets[duration, clear] for clear in STAKED):
                    bets.take(without, with_it)
                    if self.applied:
                        bets.con = max(bets.con, 0.0)
                self.proven = self.proven or (self.wealth >= self.needed and not self.doubted)
        if self.kept and self.proven and not before:
            self.kept = replace(self.kept, found=now)

    def see(self, errors: dict[float, list[tuple[Place, Place]]]) -> None:
        """Outages on which nothing is staked, before the first ones that count: how long errors last."""
        for (duration, _), bets in self.bets.items():
            for without, with_it in errors[duration]:
                bets.see(without, with_it)

    def apply(self, now: int) -> None:
        """Be part of the parameters that drive. What was seen before says nothing against that any more. now: ns."""
        self.applied = True
        self.kept = Kept(self.finding.name, self.finding.parameters, self.sets, now)
        for bets in self.bets.values():
            bets.con = 0.0

    def begin_anew(self) -> None:
        """The parameters that drive have changed: what was seen before compared others, and what is not one of those
        that drive has to be proven beside them. What was won is given away and what was lost has to be won again, so
        that a wealth that does not grow in the mean does not by this either."""
        self.needed /= min(self.wealth, 1.0)
        for bets in self.bets.values():
            bets.begin_anew()
            _without_wealth(bets)
        self.errors, self.taken = {duration: [] for duration in OUTAGES}, 0
        self.proven = self.proven and self.applied

    def add_share(self, share: float) -> None:
        """Have `share` in addition."""
        self.needed *= self.share / (self.share + share)
        self.share += share

    def differs(self, finding: Finding) -> bool:
        """Whether `finding`, of the same effect, has other values. Where this one is applied, it is what is left beside
        that, of which there should be nothing."""
        if self.applied:
            return any(e.differs(replace(e, value=0.0, sigma=0.0)) for e in finding.parameters.values() if e.known)
        own = self.finding.parameters
        return any(e.differs(own[name]) for name, e in finding.parameters.items() if name in own)

    def is_refined_by(self, finding: Finding) -> bool:
        """Whether `finding`, whose values agree, is of samples behind the begin of those that showed this one, knows
        all that this one knows as well, and something better."""
        old, new = ({name: e.sigma for name, e in one.parameters.items() if e.known} for one in (self.finding, finding))
        better = new.keys() > old.keys() or any(new[name] < WORTH * old[name] for name in new.keys() & old.keys())
        return (better and finding.since >= self.finding.since
                and all(name in new and new[name] <= sigma for name, sigma in old.items()))

    def refine(self, finding: Finding) -> None:
        """Go on with its values. What has been bet stays: each bet is on what was known before its outage, and a wealth
        that does not grow in the mean does so with whichever value each was."""
        self.finding, self.sets = replace(finding, since=self.finding.since), finding.changes

    def quantity(self, now: int, name: str) -> Quantity:
        """It in words, as `name`. now: ns, stamp of the newest sample."""
        better = {d: (*np.mean(pairs, axis=0).tolist(), len(pairs)) for d, pairs in self.errors.items() if pairs}
        lines = tuple(f'{parameter}: {yaml_value(_told(value))}' for parameter, value in self.sets.items())
        said = ', '.join(f'{parameter} {e.text()}' for parameter, e in self.finding.parameters.items())
        gain = ''.join(f'; {d:g} s without fixes {a:.2f} m without it and {b:.2f} m with it, {n} times'
                       for d, (a, b, n) in better.items())
        return Quantity(now, name, self.state, self.finding.parameters, lines, better,
                        f"{said}{gain}{self._why()}; {'applied' if self.applied else 'to set'}: {'; '.join(lines)}",
                        self.applied, self.kept, self.advice.text() if self.advice and not self.proven else '')

    def _why(self) -> str:
        """Why it is SUSPECT, for the sentence."""
        if self.rejected:
            return '; predictions are worse with it'
        if not self.seen:
            return '; the last minutes show another value' if self.applied else '; not found in the last minutes'
        return '; not proven in this drive yet' if self.applied and not self.proven else ''


def _without_wealth(bets: Bets) -> Bets:
    """The bets with no wealth for the finding in them yet."""
    bets.pro = -math.inf
    return bets


def _told(value):
    """A parameter with as many digits as are worth copying: no sigma here is so small a part of its value."""
    if isinstance(value, list):
        return [_told(one) for one in value]
    return float(f'{value:.{DIGITS}g}') if isinstance(value, float) else value
