"""A finding on trial: the bets on it in the outages after it, its state, and the state in words."""
from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np

from ..filter.runs.betting import CLEAR, Bets
from ..parameters.params_file import yaml_value
from .advice import WORTH, Advice
from .findings import Finding
from .quantity import COARSE, FINE, SUSPECT, EarlierFinding, FindingState
from .trial_outages import OUTAGES, Place

#: wealth against an applied finding at which it is removed. A useful finding is removed at most once in this many
#: outages, a day of the shortest ones
TAKEN_BACK = 86_400.0
#: wealth against a finding in outages of one duration above which it is not proven: parameters that follow the errors
#: of the fixes predict the next fix better, but worse over half a minute. If this wealth is reached in all outages and
#: the last minutes show another value, an applied finding is removed: both would have to be wrong by chance. An antenna
#: is observed only in turns, and one or two turns after it has been moved do not reach TAKEN_BACK
DOUBTED = 20.0
#: smallest distance of the predictions for the two bets on each duration: bets on all outages add up small differences
#: (fixes of metres); bets only on clear ones lose nothing on a straight road
STAKED = (0.0, CLEAR)
#: s without fixes, of each duration, before the first stake, in which the correlation time of errors is estimated
UNSTAKED = 30.0
ALONE = '; the filter has an estimate only with it, so there is nothing to compare it with'
ACCEPT = ': ~/calibration/accept applies it'
#: number of digits of a parameter in a line to copy
DIGITS = 5


@dataclass
class Trial:
    """A finding on trial. sets: parameters with the finding. needed: wealth with which it is proven. number: of the
    trial in this drive. share: probability of proving it by chance (`false_alarms.py`).

    applied: whether it is part of the parameters that are used. harmful: whether it was, and has been removed. seen: of
    one that is applied, whether no other value of it is on trial; else, whether the last analysis of all samples has
    found it. kept: for the next drive, if it is applied. advice: manoeuvres that would show it better. errors: by
    duration, m, without it and with it in each outage. bets: by duration and by the smallest distance of the
    predictions (`betting.CLEAR`), with the wealth staked so far: of the initial wealth 1, the part 1 / (k (k + 1)) is
    staked from the k-th chunk on. So losses on a straight road, where the states of the filters decide by chance, need
    not be made up for in the next turn. No wealth is created by this, so the probability of a proof by chance is the
    same. taken: number of chunks.
    """

    finding: Finding
    sets: dict
    needed: float
    applied: bool = False
    proven: bool = False
    harmful: bool = False
    seen: bool = True
    kept: EarlierFinding | None = None
    advice: Advice | None = None
    errors: dict[float, list[tuple[float, float]]] = field(default_factory=lambda: {d: [] for d in OUTAGES})
    bets: dict[tuple[float, float], Bets] = field(default_factory=lambda: {
        (d, clear): _without_wealth(Bets(clear, math.ceil(UNSTAKED / d))) for d in OUTAGES for clear in STAKED})
    taken: int = 0
    alone: bool = False
    number: int = 0
    share: float = field(init=False)

    def __post_init__(self):
        self.share = 1.0 / self.needed

    @property
    def wealth(self) -> float:
        """Wealth staked on the finding: that of all bets with equal weights, and the part that is not staked yet."""
        return 1.0 / (self.taken + 1) + float(np.mean([np.exp(bets.pro) for bets in self.bets.values()]))

    @property
    def harm(self) -> float:
        """Wealth staked against it."""
        return float(np.mean([np.exp(bets.con) for bets in self.bets.values()]))

    @property
    def doubted(self) -> bool:
        """Whether outages of any duration are evidence against it."""
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

    def take(self, errors: dict[float, list[tuple[Place, Place]]], now: int = 0, alone: bool = False) -> None:
        """Bet on the outages of one more chunk, by duration: distances of the fixes from both filters, m. now: ns, its
        end. alone: as in the class."""
        before = self.proven
        self.taken += 1
        self.alone = alone
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
        """Outages without a stake, before the first bets, for the correlation time of errors."""
        for (duration, _), bets in self.bets.items():
            for without, with_it in errors[duration]:
                bets.see(without, with_it)

    def apply(self, now: int) -> None:
        """Become part of the parameters that are used. Earlier evidence against the finding is discarded. now: ns."""
        self.applied = True
        self.kept = EarlierFinding(self.finding.name, self.finding.parameters, self.sets, now)
        for bets in self.bets.values():
            bets.con = 0.0

    def begin_anew(self) -> None:
        """Begin anew after a change of the parameters that are used, to which the earlier bets do not refer. Gains are
        given away and losses are kept, so that the mean of the wealth does not grow by this."""
        self.needed /= min(self.wealth, 1.0)
        for bets in self.bets.values():
            bets.begin_anew()
            _without_wealth(bets)
        self.errors, self.taken = {duration: [] for duration in OUTAGES}, 0
        self.proven = self.proven and self.applied

    def add_share(self, share: float) -> None:
        """Add `share` to the wealth."""
        self.needed *= self.share / (self.share + share)
        self.share += share

    def differs(self, finding: Finding) -> bool:
        """Whether `finding`, of the same effect, has other values. If this one is applied, `finding` is the rest, which
        should be zero."""
        if self.applied:
            return any(e.differs(replace(e, value=0.0, sigma=0.0)) for e in finding.parameters.values() if e.known)
        own = self.finding.parameters
        return any(e.differs(own[name]) for name, e in finding.parameters.items() if name in own)

    def is_refined_by(self, finding: Finding) -> bool:
        """Whether `finding`, whose values agree, is from later samples than those that showed this one, has all its
        parameters, and knows one of them better."""
        old, new = ({name: e.sigma for name, e in one.parameters.items() if e.known} for one in (self.finding, finding))
        better = new.keys() > old.keys() or any(new[name] < WORTH * old[name] for name in new.keys() & old.keys())
        return (better and finding.since >= self.finding.since
                and all(name in new and new[name] <= sigma for name, sigma in old.items()))

    def refine(self, finding: Finding) -> None:
        """Continue with the values of `finding`. The bets remain valid: each was made with values that were known
        before its outage."""
        self.finding, self.sets = replace(finding, since=self.finding.since), finding.changes

    def quantity(self, now: int, name: str) -> FindingState:
        """The state in words, as `name`. now: ns, stamp of the newest sample."""
        better = {d: (*np.mean(pairs, axis=0).tolist(), len(pairs)) for d, pairs in self.errors.items() if pairs}
        lines = tuple(f'{parameter}: {yaml_value(_told(value))}' for parameter, value in self.sets.items())
        said = ', '.join(f'{parameter} {e.text()}' for parameter, e in self.finding.parameters.items())
        gain = ''.join(f'; {d:g} s without fixes {a:.2f} m without it and {b:.2f} m with it, {n} times'
                       for d, (a, b, n) in better.items())
        return FindingState(now, name, self.state, self.finding.parameters, lines, better,
                            f"{said}{gain}{self._why()}; {'applied' if self.applied else 'to set'}: {'; '.join(lines)}",
                            self.applied, self.kept, self.advice.text() if self.advice and not self.proven else '')

    def _why(self) -> str:
        """Why it is SUSPECT or cannot be proven, for the sentence."""
        if self.rejected:
            return '; predictions are worse with it'
        if not self.seen:
            return '; the last minutes show another value' if self.applied else '; not found in the last minutes'
        if self.alone and not self.proven:
            return f"{ALONE}{'' if self.applied else ACCEPT}"
        return '; not proven in this drive yet' if self.applied and not self.proven else ''


def _without_wealth(bets: Bets) -> Bets:
    """The bets without wealth for the finding."""
    bets.pro = -math.inf
    return bets


def _told(value):
    """A parameter with as many digits as are useful in a file: no sigma is a smaller part of its value."""
    if isinstance(value, list):
        return [_told(one) for one in value]
    return float(f'{value:.{DIGITS}g}') if isinstance(value, float) else value
