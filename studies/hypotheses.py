"""Hypotheses side by side in place of counters: copies of the filter's memory, each with one statement.

    python studies/hypotheses.py [--seeds 2] [--first-seed 2001] [--rate 1] [--only NAME,NAME] [--also-as-it-is]
                                 [--verbose] [--output FILE.md]

A member is a copy of the filter's memory whose own checks are off (no gate, no Huber weights), and says whom it does
not believe since t0: nobody (*nominal*), the *fixes*, or the *IMU*; or that the state had *diverged*, and began anew
from a line through the latest fixes. Its score is the logarithm of the prior (rates below) and of the likelihood of
all that has come since: fixes, lateral constraints, standstills. In an undisturbed drive there is one member. A fix
that fits it too badly, fixes that go straight on to the centimetre, or constraints that do not fit start hypotheses;
who agrees with a better one or has lost by DROPPED goes. What is published is the best member, with the covariance of
the mixture about it (D. T. Magill, "Optimal adaptive estimation of sampled stochastic processes", IEEE Trans.
Automatic Control 10, 1965; H. A. P. Blom and Y. Bar-Shalom, "The interacting multiple model algorithm", the same 33,
1988).

It is a prototype over `kernel.run`, for replays of simulated drives: fixes in time, no outages, no further sensors. The
table holds for each drive the largest error from the fault's begin to 60 s after its end, the error (RMS of 5 s) 20 and
60 s after the end, and how often the 95 % ellipse held the truth and its median reach from begin to 60 s after the end.
"""
from __future__ import annotations

import argparse
import math
from dataclasses import dataclass, field, replace
from pathlib import Path

import faults
import numpy as np

from mems_ins_fusion.filter import kernel
from mems_ins_fusion.filter.bank import Bank as Installed
from mems_ins_fusion.filter.memory import (
    NAV,
    STRAPDOWN,
    Event,
    Head,
    Kind,
    Nav,
    Sample,
    Verdict,
    covariance,
    covariance_index,
    set_covariance,
    state_at,
    variance_factor,
)
from mems_ins_fusion.filter.runs import replay
from mems_ins_fusion.filter.runs.results import _SCALES
from mems_ins_fusion.filter.trust.receiver import realised_scatter
from mems_ins_fusion.navigation.planar import State as Planar
from mems_ins_fusion.navigation.strapdown import State as Strapdown
from mems_ins_fusion.navigation.strapdown import from_euler, to_euler

#: 1/s: a receiver is wrong for a while once an hour (multipath, tunnels; that is what drives in cities show)
FIXES_WRONG = 1 / 3600.0
#: 1/s: an IMU once in a hundred hours (loose mounts, kerbs, drivers that mix up axes)
IMU_WRONG = 1 / 3.6e5
#: 1/s: who is wrong is right again after 20 s
ENDS = 1 / 20.0
#: 1/s: faults come in clusters: so often in the LATELY s after one has ended
AGAIN, LATELY = 1 / 100.0, 100.0
#: of those who do not believe the fixes, the part that has diverged itself
STRAYED = 0.05
#: share of the fixes that are off for themselves
OUTLIERS = 0.01
#: a fix that is anywhere is as likely between 10 and 20 m as between 100 and 200 m off: logarithm of the range
RANGE = math.log(1000.0)
#: m: a receiver that goes straight on does so to this, from its last two fixes
STRAIGHT = 0.15
#: 1/s: those that are wrong change the way in which they are
CHANGES = 0.02
#: variances that the offset of wrong fixes gathers: m^2/s where it stays and where it drifts, m^2/s^3 of its drift
STAYS, WANDERS, TURNS = 0.0004, 0.01, 0.02
#: m/s: sigma of the drift of wrong fixes
DRIFT = 3.0
#: members are dropped when they have lost by so many nats; no more than so many go on
DROPPED, MOST = 9.0, 6
#: normalized innovation squared that starts hypotheses: one fix in a hundred, by chance
MISFIT = 9.2
#: and nats of constraints
SLIDES = 4.0
#: s: how long ago it may have begun
BACK = (0.0, 4.0, 10.0)
#: s between states that are remembered for that, and how long
REMEMBERED, LONGEST = 2.0, 12.5
#: s after which who does not believe the IMU tries it again, and who does not believe the fixes begins anew from them
TRY_AGAIN, BEGIN_ANEW = 2.0, 2.5
#: constraints are applied ten times a second, and their errors last a second
TEMPER = 0.1
#: s over which the usual normalized innovation squared of the constraint is learned, and the least
USUALLY, LEAST_USUAL = 30.0, 0.003
#: degrees of freedom of the constraint's t distribution: measured drives have slides of 29 times the usual
FREEDOM = 10.0
#: m/s: of a lateral velocity, and one at standstill, of which an IMU that is wrong tells
ANY_SLIP = 3.0
#: m/s: slower the course tells no heading; its sigma, rad; and of the tilt when it is known again
COURSE_SPEED, COURSE_SIGMA, TILT_SIGMA = 3.0, 0.1, 0.05
_STUDENT = math.lgamma(0.5 * (FREEDOM + 1)) - math.lgamma(0.5 * FREEDOM) - 0.5 * math.log(math.pi * FREEDOM)
_NO_EVENTS, _NO_INDEX = np.zeros((0, Event.SIZE)), np.zeros(0, dtype=np.int64)


def anywhere(z: np.ndarray, r: float) -> float:
    """Density, 1/m^2, of a fix that is z (2,) m off and may be anywhere; r: its variance, m^2."""
    return 1.0 / (2 * math.pi * RANGE * (z @ z + 4.0 * r))


def normal(z: np.ndarray, s) -> float:
    """Density of z (2,) with the covariance s: nn, ne, ee."""
    determinant = s[0] * s[2] - s[1] * s[1]
    nis = (s[2] * z[0] ** 2 - 2 * s[1] * z[0] * z[1] + s[0] * z[1] ** 2) / determinant
    return math.exp(-0.5 * min(nis, 1400.0)) / (2 * math.pi * math.sqrt(determinant))


def realised_of(row: np.ndarray) -> float:
    """Realised over claimed variance of the fixes, where it is above 1, of the state in `row`."""
    return max(1.0, realised_scatter(row, 0))


def _rate(usually: float, since: float) -> float:
    """Logarithm of the prior of a fault within a second, `since` s after another one has ended."""
    return math.log(AGAIN if 0.0 <= since < LATELY else usually)


def _nats(density: float) -> float:
    return math.log(max(density, 1e-300))


@dataclass
class Wrong:
    """In which way fixes are wrong: by an offset that stays, by one that drifts, straight on, anywhere; what each of
    these has learned, and how likely it is (share, (4,))."""

    share: np.ndarray = field(default_factory=lambda: np.array([0.3, 0.2, 0.25, 0.25]))
    time: float = 0.0
    stays: np.ndarray | None = None  # (2,) m
    stays_variance: float = 0.0
    drifts: np.ndarray | None = None  # (2, 2): of north and east, m and m/s
    drifts_covariance: np.ndarray | None = None
    _after: Wrong | None = None

    def density(self, z: np.ndarray, r: float, time: float, straight: np.ndarray | None) -> float:
        """Of a fix off by z (2,) m with variance r, straight (2,) m off from straight on, where that is known."""
        densities, share = np.full(4, anywhere(z, r)), self.share
        if self.stays is None:
            after = Wrong(share, time, z, r, np.stack([z, np.zeros(2)], axis=1), np.diag([r, DRIFT**2]))
        else:
            dt = time - self.time
            f = np.array([[1.0, dt], [0.0, 1.0]])
            drifts = self.drifts @ f.T
            p = f @ self.drifts_covariance @ f.T + np.diag([WANDERS * dt, TURNS * dt])
            variance = self.stays_variance + STAYS * dt
            densities[0] = normal(z - self.stays, (variance + r, 0.0, variance + r))
            densities[1] = normal(z - drifts[:, 0], (p[0, 0] + r, 0.0, p[0, 0] + r))
            gain, mine = variance / (variance + r), p[:, 0] / (p[0, 0] + r)
            after = Wrong(share, time, self.stays + gain * (z - self.stays), (1.0 - gain) * variance,
                          drifts + np.outer(z - drifts[:, 0], mine), p - np.outer(mine, p[0]))
            changed = 1.0 - math.exp(-CHANGES * dt)
            share = (1.0 - changed) * share + changed / 4
        if straight is not None:
            densities[2] = normal(straight, (STRAIGHT**2, 0.0, STRAIGHT**2))
        total = float(share @ densities)
        after.share = share * densities / max(total, 1e-300)
        self._after = after
        return total

    def learned(self) -> Wrong:
        """With the fix whose density was asked for last."""
        return self._after


@dataclass(frozen=True)
class Past:
    """A state of the undisturbed filter: samples taken, time, memory, score."""

    place: int
    time: float
    memory: np.ndarray
    score: float


@dataclass(eq=False)
class Member:
    """One hypothesis. wrong: what it knows of wrong fixes, None where it believes them. imu_wrong: it goes straight on
    between fixes. last: time of the last fix judged. tried: when it last tried to begin anew. usual: normalized
    innovation squared of the lateral constraint that is usual for this vehicle. fixes_ended, imu_ended: when they were
    right again, s."""

    name: str
    memory: np.ndarray
    score: float = 0.0
    wrong: Wrong | None = None
    imu_wrong: bool = False
    last: float = 0.0
    tried: float = 0.0
    usual: float = 0.25
    past: tuple[Past, ...] = ()
    states: np.ndarray | None = None
    fixes_ended: float = -math.inf
    imu_ended: float = -math.inf

    def copy(self, **more) -> Member:
        return replace(self, **{'memory': self.memory.copy(), **more})

    @property
    def is_nominal(self) -> bool:
        return self.wrong is None and not self.imu_wrong

    @property
    def row(self) -> np.ndarray:
        """The newest state."""
        at = state_at(self.memory, int(self.memory[Head.SAMPLES]))
        return self.memory[at:at + int(self.memory[Head.WIDTH])]


class Bank(replay.Replay):
    """A replay with hypotheses."""

    verbose = False

    def _filter(self, memory, samples, index, events, epoch):
        memory[Head.GATE] = memory[Head.ROBUST_SIGMA] = memory[Installed.SIZE] = 0.0
        self.samples, self.layout, self.place = samples, self.config.layout, 0
        states = Strapdown if self.config.mechanization == STRAPDOWN else Planar
        self.velocity = [states.V_N, states.V_N + 1]
        self.members = [Member('nominal', memory)]
        self.fixes: list[tuple[int, np.ndarray, np.ndarray | None]] = []  # samples before, record, off from straight on
        self.straight_on = self.slid = 0.0
        self.out = np.empty((len(samples), len(self.columns)))
        events.event[:, Event.ID] = np.arange(len(events.kind))
        for kind, arrival, record in zip(events.kind, events.arrival, events.event):
            after = int(np.searchsorted(samples[:, 0], record[Event.TIME])) + 1
            self.advance(min(max(int(arrival), after), len(samples)))
            if kind == Kind.POSITION:
                self.judge(record.copy())
            else:
                for member in self.members:
                    self.give(member, record)
            record[[Event.VERDICT, Event.S_NN, Event.S_EE]] = Verdict.USED, 1.0, 1.0
        self.advance(len(samples))
        self.stretches.append(replay.Stretch(index, self.out))
        memory[:] = self.best.memory

    @property
    def best(self) -> Member:
        return max(self.members, key=lambda member: member.score)

    def advance(self, stop: int) -> None:
        """All members up to sample `stop`, a second at a time."""
        while self.place < stop:
            end = min(stop, self.place + max(1, int(np.searchsorted(
                self.samples[self.place:stop, 0], self.samples[self.place, 0] + 1.0))))
            for member in self.members:
                member.states = np.empty((end - self.place, len(self.columns)))
                gained = self.run_member(member, self.place, end, member.states)
            self.publish(self.out[self.place:end])
            self.place = end
            if len(self.members) > 1:
                self.prune()
            elif self.members[0].is_nominal:
                self.slid = min(self.slid + gained, 0.0)
                if self.slid < -SLIDES:
                    self.slid = 0.0
                    self.members += self.without_imu(self.members[0])
                    self.prune()
                self.remember(self.members[0])

    def remember(self, member: Member) -> None:
        now = self.samples[self.place - 1, 0]
        if not member.past or now - member.past[-1].time >= REMEMBERED:
            member.past = (*(p for p in member.past if now - p.time < LONGEST),
                           Past(self.place, now, member.memory.copy(), member.score))

    def run_member(self, member: Member, begin: int, stop: int, states=None) -> float:
        """Through samples[begin:stop]; what the vehicle's constraints say, against an IMU that is wrong, in nats."""
        if begin >= stop:
            return 0.0
        kept = _NO_INDEX if states is None else np.arange(stop - begin)
        states = np.zeros((0, len(self.columns))) if states is None else states
        kernel.run(member.memory, self.samples[begin:stop], _NO_EVENTS, _NO_INDEX, _NO_INDEX, self.columns, kept,
                   states, _NO_EVENTS)
        if member.imu_wrong:
            return 0.0
        memory, capacity = member.memory, int(member.memory[Head.CAPACITY])
        ring = memory[int(memory[Head.RING_AT]):][:capacity * Sample.SIZE].reshape(capacity, Sample.SIZE)
        newest = int(memory[Head.SAMPLES])
        rows, gained = ring[np.arange(newest - (stop - begin) + 1, newest + 1) % capacity], 0.0
        for row in rows[rows[:, Sample.CONSTRAINT] == Kind.ZERO_VELOCITY]:
            nis = min(float((row[Sample.Z:Sample.Z + 2] ** 2 / row[Sample.S:Sample.S + 2]).sum()), 28.0)
            gained -= 0.5 * TEMPER * nis
        for row in rows[rows[:, Sample.CONSTRAINT] == Kind.NON_HOLONOMIC]:
            nis = row[Sample.Z] ** 2 / row[Sample.S]
            scale = max(member.usual, LEAST_USUAL)
            fits = (_STUDENT - 0.5 * math.log(scale * row[Sample.S])
                    - 0.5 * (FREEDOM + 1) * math.log1p(nis / scale / FREEDOM))
            gained += TEMPER * (fits + math.log(math.sqrt(2 * math.pi) * ANY_SLIP))
            if member.is_nominal and len(self.members) == 1:
                member.usual += (min(nis, 10.0 * member.usual) - member.usual) * TEMPER / USUALLY
        member.score += gained
        return gained

    def publish(self, out: np.ndarray) -> None:
        """The best member's states, with the covariance of position of the mixture about it."""
        weights = np.exp(np.array([member.score for member in self.members]) - self.best.score)
        weights /= weights.sum()
        out[:] = self.best.states
        if len(self.members) == 1:
            return
        kept = [*range(Nav.RADII_LATITUDE), *_SCALES]
        factor_at, lasting_at = kept.index(Nav.VARIANCE_FACTOR), kept.index(Nav.LASTING)
        variance = len(kept) + self.layout.n
        covariance_ne = variance + self.layout.n
        total = np.zeros((3, len(out)))
        for weight, member in zip(weights, self.members):
            states = member.states
            north = (states[:, Nav.LATITUDE] - out[:, Nav.LATITUDE]) / out[:, kept.index(Nav.NORTH_SCALE)]
            east = (states[:, Nav.LONGITUDE] - out[:, Nav.LONGITUDE]) / out[:, kept.index(Nav.EAST_SCALE)]
            factor, lasting = np.maximum(1.0, states[:, factor_at]), states[:, lasting_at]
            total += weight * np.array([factor * states[:, variance] + lasting + north**2,
                                        factor * states[:, variance + 1] + lasting + east**2,
                                        factor * states[:, covariance_ne] + north * east])
        factor, lasting = np.maximum(1.0, out[:, factor_at]), out[:, lasting_at]
        out[:, variance], out[:, variance + 1] = (total[0] - lasting) / factor, (total[1] - lasting) / factor
        out[:, covariance_ne] = total[2] / factor

    def give(self, member: Member, record: np.ndarray, weight: float = 1.0) -> None:
        """A measurement to a member, believed with `weight`; a height that is off has its own."""
        given = record.copy()[None]
        given[0, [Event.R_NN, Event.R_NE, Event.R_EE]] /= weight
        if record[Event.KIND] == Kind.POSITION and self.config.mechanization == STRAPDOWN:
            s = member.row[covariance_index(Strapdown.R_D, Strapdown.R_D, self.layout)] + record[Event.R_DD]
            off = record[Event.HEIGHT] - member.row[Nav.HEIGHT]
            good = (1 - OUTLIERS) * math.exp(-0.5 * min(off**2 / s, 1400.0)) / math.sqrt(2 * math.pi * s)
            given[0, Event.R_DD] *= 1.0 + OUTLIERS / (2 * RANGE * (abs(off) + math.sqrt(s))) / max(good, 1e-12)
        kernel.run(member.memory, self.samples[:0], given, np.zeros(1, dtype=np.int64), np.zeros(1, dtype=np.int64),
                   self.columns, _NO_INDEX, np.zeros((0, len(self.columns))), _NO_EVENTS)

    def innovation(self, member: Member, record: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Predicted minus measured position (2,), its covariance nn, ne, ee, and the variance of the fix, m^2."""
        memory, k = member.memory, int(member.memory[Head.SAMPLES])
        while k > 0 and memory[state_at(memory, k) + Nav.TIME] > record[Event.TIME]:
            k -= 1
        row = memory[state_at(memory, k):][:int(memory[Head.WIDTH])]
        dt = record[Event.TIME] - row[Nav.TIME]
        z = np.array([(row[Nav.LATITUDE] - record[Event.LATITUDE]) / row[Nav.NORTH_SCALE] + dt * row[Nav.V_N],
                      (row[Nav.LONGITUDE] - record[Event.LONGITUDE]) / row[Nav.EAST_SCALE] + dt * row[Nav.V_E]])
        ratio = realised_of(row) if memory[Head.ADAPT] else 1.0
        p = row[[covariance_index(i, j, self.layout) for i, j in ((0, 0), (0, 1), (1, 1))]]
        r = ratio * record[[Event.R_NN, Event.R_NE, Event.R_EE]]
        return z, variance_factor(row, 0) * p + r, 0.5 * (r[0] + r[2])

    def believed(self, member: Member, record: np.ndarray) -> tuple[float, float]:
        """Log density of a fix for one who believes fixes, but for outliers, and how far this one is believed."""
        z, s, r = self.innovation(member, record)
        good, bad = (1 - OUTLIERS) * normal(z, s), OUTLIERS * anywhere(z, r)
        return math.log(good + bad), good / (good + bad)

    def off_straight(self, record: np.ndarray) -> np.ndarray | None:
        """How far, (2,) m, a fix is from straight on, by the two before it."""
        if len(self.fixes) < 2:
            return None
        (_, a, _), (_, b, _) = self.fixes[-2:]
        before, now = b[Event.TIME] - a[Event.TIME], record[Event.TIME] - b[Event.TIME]
        if not (0.0 < before < 3.0 and 0.0 < now < 3.0):
            return None
        scales = self.best.row[[Nav.NORTH_SCALE, Nav.EAST_SCALE]]
        a, b, c = (r[[Event.LATITUDE, Event.LONGITUDE]] for r in (a, b, record))
        return (c - b - now / before * (b - a)) / scales

    def judge(self, record: np.ndarray) -> None:
        """One fix: what it says of each member, and whether others are to be heard."""
        time, straight = record[Event.TIME], self.off_straight(record)
        self.fixes = [*self.fixes[-400:], (self.place, record, straight)]
        ways = []  # score, member, whether the fix is believed, and how far
        for member in self.members:
            dt = min(max(time - member.last, 0.0), 5.0)
            nats, weight = self.believed(member, record)
            if member.wrong is not None:
                z, _, r = self.innovation(member, record)
                ended = 1.0 - math.exp(-ENDS * dt)
                ways.append((member.score + _nats(ended) + nats, member, True, weight))
                nats, weight = _nats((1.0 - ended) * member.wrong.density(z, r, time, straight)), 0.0
            ways.append((member.score + nats, member, member.wrong is None, weight))
        opened = self.opened(record, straight)
        best = max([way[0] for way in ways] + [member.score for member in opened])
        ways = sorted((way for way in ways if way[0] > best - DROPPED), key=lambda way: -way[0])
        lasts = {member: sum(way[1] is member for way in ways) for member in self.members}
        followed = []
        for score, member, is_believed, weight in ways:
            lasts[member] -= 1
            follows = member.copy() if lasts[member] else replace(member)
            follows.score, follows.last = score, time
            if not is_believed:
                follows.wrong = member.wrong.learned()
            elif member.wrong is not None:
                follows.wrong, follows.past, follows.name = None, (), f'{member.name}, right again'
                follows.fixes_ended = time
            followed.append((follows, is_believed, weight))
        for follows, is_believed, weight in followed:
            if is_believed and weight > 0.01:
                self.give(follows, record, weight)
        self.members = [follows for follows, *_ in followed] + opened
        self.prune()
        self.begin_anew(time)
        if self.verbose and not (len(self.members) == 1 and self.members[0].name == 'nominal'):
            best = self.best.score
            print(f'{time:7.1f} s', ' | '.join(f'{m.name} {m.score - best:.1f}' for m in self.members))

    def opened(self, record: np.ndarray, straight) -> list[Member]:
        """Those who say that the fixes, or the IMU, are wrong, where the best member has a misfit that is no chance."""
        best = self.best
        if not best.is_nominal:
            return []
        z, s, _ = self.innovation(best, record)
        if straight is not None and len(self.members) == 1:
            more = _nats(normal(straight, (STRAIGHT**2, 0.0, STRAIGHT**2))) - self.believed(best, record)[0]
            self.straight_on = max(self.straight_on + min(more, 5.0), 0.0)
        nis = (s[2] * z[0] ** 2 - 2 * s[1] * z[0] * z[1] + s[0] * z[1] ** 2) / (s[0] * s[2] - s[1] ** 2)
        if nis < MISFIT and self.straight_on < -math.log(FIXES_WRONG):
            return []
        self.straight_on = 0.0
        return [*self.without_fixes(best), *self.without_imu(best, True)]

    def _begins(self, member: Member) -> list[Past]:
        """When it may have begun: now, and some s ago."""
        now = self.samples[self.place - 1, 0]
        found = [Past(self.place, now, member.memory, member.score)]
        for back in BACK[1:]:
            older = [p for p in member.past if now - p.time >= back - 1.0]
            if older and older[-1].place < found[-1].place:
                found.append(older[-1])
        return found

    def _since(self, place: int):
        """The fixes that came since then; the newest one counts where it began now."""
        return self.fixes[-1:] if place == self.place else [fix for fix in self.fixes if fix[0] > place]

    def without_fixes(self, member: Member) -> list[Member]:
        found = []
        for past in self._begins(member):
            child = Member(f'fixes wrong since {past.time:.0f}', past.memory.copy(),
                           past.score + _rate(FIXES_WRONG, past.time - member.fixes_ended),
                           Wrong(), last=past.time, tried=past.time, usual=member.usual,
                           imu_ended=member.imu_ended)
            at = past.place
            for place, record, straight in self._since(past.place):
                self.run_member(child, at, place)
                at, (z, _, r), time = place, self.innovation(child, record), record[Event.TIME]
                child.score += _nats(child.wrong.density(z, r, time, straight)) - ENDS * max(time - child.last, 0.0)
                child.wrong, child.last = child.wrong.learned(), time
            found.append(child)
        return found

    def without_imu(self, member: Member, with_newest: bool = False) -> list[Member]:
        found = []
        for past in self._begins(member)[:2]:
            child = Member(f'IMU wrong since {past.time:.0f}', past.memory.copy(),
                           past.score + _rate(IMU_WRONG, past.time - member.imu_ended),
                           imu_wrong=True, last=past.time, tried=self.samples[self.place - 1, 0], usual=member.usual,
                           fixes_ended=member.fixes_ended)
            child.row[Nav.DIVERGENCE_TIME] = 1e9  # prediction goes straight on
            at = past.place
            for place, record, _ in self._since(past.place):
                if place == self.place and not with_newest:
                    continue
                self.run_member(child, at, place)
                at, (nats, weight) = place, self.believed(child, record)
                child.score, child.last = child.score + nats, record[Event.TIME]
                if weight > 0.01:
                    self.give(child, record, weight)
            self.run_member(child, at, self.place)
            found.append(child)
        return found

    def begin_anew(self, time: float) -> None:
        """Who does not believe the fixes may have diverged; an IMU that was wrong may be right again."""
        for member in list(self.members):
            if member.wrong is not None and member is self.best and time - member.tried > BEGIN_ANEW:
                member.tried = time
                self.members += self.strayed(member)
            elif member.imu_wrong and time - member.tried > TRY_AGAIN:
                member.tried = time
                child = member.copy(name='IMU right again', imu_wrong=False, past=(), imu_ended=time,
                                    score=member.score + math.log(ENDS * TRY_AGAIN))
                child.row[Nav.DIVERGENCE_TIME] = 0.0
                self.take_course(child)
                self.members.append(child)

    def diverged(self, member: Member) -> list[Member]:
        """As `member`, with position and velocity of a line through the fixes of the last two seconds."""
        now = self.fixes[-1][1][Event.TIME]
        used = np.array([record for _, record, _ in self.fixes if now - record[Event.TIME] < 2.1])
        if len(used) < 3 or self.config.mechanization != STRAPDOWN:
            return []
        child = member.copy(name='diverged', wrong=None, past=(), imu_ended=now, score=member.score + math.log(STRAYED))
        row, n, s = child.row, self.layout.n_navigation, Strapdown
        time = used[:, Event.TIME] - row[Nav.TIME]
        design = np.column_stack([np.ones(len(time)), time])
        inverse = np.linalg.inv(design.T @ design)
        place, velocity = inverse @ design.T @ used[:, [Event.LATITUDE, Event.LONGITUDE]]
        row[[Nav.LATITUDE, Nav.LONGITUDE]] = place
        row[[Nav.V_N, Nav.V_E]] = velocity / row[[Nav.NORTH_SCALE, Nav.EAST_SCALE]]
        row[Nav.HEIGHT], row[Nav.V_D] = used[-1, Event.HEIGHT], 0.0
        r = realised_of(row) * used[:, [Event.R_NN, Event.R_EE]].mean()
        p = covariance(row, self.layout)
        p[:n, :] = p[:, :n] = 0.0
        # an IMU that has led astray may have other errors than before: those that it was switched on with
        for k, (model, turn_on) in enumerate(zip(self.config.models, self.config.turn_on_sigma)):
            k = n + k * self.layout.order
            p[k, k] = max(4.0 * p[k, k], model.initial_covariance()[0, 0] + turn_on**2)
        p[s.R_N, s.R_N] = p[s.R_E, s.R_E] = r * inverse[0, 0] + 0.5**2
        p[s.V_N, s.V_N] = p[s.V_E, s.V_E] = r * inverse[1, 1] + (0.5 * (time[-1] - time[0])) ** 2
        p[s.R_D, s.R_D], p[s.V_D, s.V_D], p[s.PHI_D, s.PHI_D] = 4.0 * used[-1, Event.R_DD], 0.5**2, math.pi**2 / 3
        set_covariance(row, self.layout, p)
        self.take_course(child)
        return [child]

    def take_course(self, member: Member) -> None:
        """The heading of the course, where that is better known, and a tilt that no road exceeds."""
        row, s = member.row, Strapdown
        if self.config.mechanization != STRAPDOWN:
            return
        p = covariance(row, self.layout)
        row[[Nav.LATERAL_NIS, Nav.VERTICAL_NIS]] = 0.0
        for i in (s.PHI_N, s.PHI_E):
            p[i, :] = p[:, i] = 0.0
            p[i, i] = TILT_SIGMA**2
        speed, mounting = math.hypot(row[Nav.V_N], row[Nav.V_E]), self.layout.index('mounting_yaw')
        if speed > COURSE_SPEED:
            yaw = math.atan2(row[Nav.V_E], row[Nav.V_N])
            variance = COURSE_SIGMA**2 + 0.5 * (p[s.V_N, s.V_N] + p[s.V_E, s.V_E]) / speed**2
            if mounting >= 0:
                yaw, variance = yaw - row[NAV + mounting], variance + p[mounting, mounting]
            if variance < p[s.PHI_D, s.PHI_D]:
                p[s.PHI_D, :] = p[:, s.PHI_D] = 0.0
                p[s.PHI_D, s.PHI_D] = variance
                roll, pitch, _ = to_euler(tuple(row[Nav.Q_W:Nav.Q_Z + 1]))
                row[Nav.Q_W:Nav.Q_Z + 1] = from_euler(roll, pitch, yaw)
        set_covariance(row, self.layout, p)

    def prune(self) -> None:
        """Who agrees with a better one is one with it, who has lost is gone."""
        kept: list[Member] = []
        for member in sorted(self.members, key=lambda m: -m.score):
            if kept and member.score < kept[0].score - DROPPED:
                break
            same = next((other for other in kept if self.agree(member, other)), None)
            if same is None:
                kept.append(member)
            else:
                same.score = np.logaddexp(same.score, member.score)
        self.members = kept[:MOST]
        if len(kept) == 1:
            kept[0].score = 0.0
            if kept[0].is_nominal:
                kept[0].name = 'nominal'

    def agree(self, one: Member, other: Member) -> bool:
        """Whether two say the same, and of the same state."""
        if (one.wrong is None, one.imu_wrong) != (other.wrong is None, other.imu_wrong):
            return False
        x, y = one.row, other.row
        d = np.array([(x[Nav.LATITUDE] - y[Nav.LATITUDE]) / x[Nav.NORTH_SCALE],
                      (x[Nav.LONGITUDE] - y[Nav.LONGITUDE]) / x[Nav.EAST_SCALE],
                      x[Nav.V_N] - y[Nav.V_N], x[Nav.V_E] - y[Nav.V_E], self.yaw(x) - self.yaw(y)])
        d[4] = math.remainder(d[4], 2 * math.pi)
        where = [0, 1, *self.velocity, self.layout.n_navigation - 1]
        variance = np.minimum(*(row[[covariance_index(i, i, self.layout) for i in where]] for row in (x, y)))
        return bool((d**2 < 0.1 * variance).all())

    def yaw(self, row: np.ndarray) -> float:
        if self.config.mechanization != STRAPDOWN:
            return row[Nav.YAW]
        return to_euler(tuple(row[Nav.Q_W:Nav.Q_Z + 1]))[2]


def run_bank(config, imu, fixes, aiding=replay.Aiding(), start=None, keep=None):
    """As `replay.run`, with hypotheses; all states are kept."""
    return Bank(config, imu, fixes, aiding, start, keep).run()


def cells(found: list[faults.Outcome], duration: float) -> str:
    """What the table holds of the outcomes of some drives."""
    def rms_after(o, seconds):
        return faults.rms(o.error[np.abs(o.time - duration - seconds) < 2.5])

    during = [(o.time >= 0) & (o.time <= duration + 60.0) for o in found]
    held = np.concatenate([o.inside[d] for o, d in zip(found, during)])
    reach = np.concatenate([o.reach[d] for o, d in zip(found, during)])
    numbers = [[o.error[d].max() for o, d in zip(found, during)], *([rms_after(o, s) for o in found] for s in (20, 60))]
    return (' | '.join(', '.join(f'{v:.1f}' if v < 100 else f'{v:.0f}' for v in row) for row in numbers)
            + f' | {100 * held.mean():.0f} % | {np.median(reach):.1f}')


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument('--seeds', type=int, default=2)
    parser.add_argument('--first-seed', type=int, default=2001)
    parser.add_argument('--rate', type=float, default=1.0, help='of the fixes, Hz')
    parser.add_argument('--only', default='', help='faults with one of these in their name, separated by commas')
    parser.add_argument('--also-as-it-is', action='store_true', help='the filter as it is in rows of its own')
    parser.add_argument('--verbose', action='store_true', help='the members at each fix while there are hypotheses')
    parser.add_argument('--output', type=Path)
    options = parser.parse_args()
    Bank.verbose = options.verbose
    ways = {'bank': run_bank, **({'as it is': replay.run} if options.also_as_it_is else {})}
    lines = ['| fault | filter | largest, m | 20 s after, m | 60 s after, m | in 95 % | reach, m |', '|---' * 7 + '|']
    print(*lines, sep='\n', flush=True)
    values = faults.table.check({'reference_lever_arm': [0.0, 0.0, 0.0]})
    for fault in faults.FAULTS:
        if fault.values or not any(part in fault.name for part in options.only.split(',')):
            continue
        for name, way in ways.items():
            found = []
            for seed in range(options.first_seed, options.first_seed + options.seeds):
                clean = faults.clean_drive(seed, options.rate)
                found.append(faults.outcome(faults.altered(fault, clean, seed), faults.truth_of(clean, values), values,
                                            fault.begin(clean), way))
            lines.append(f'| {fault.name} | {name} | {cells(found, fault.duration)} |')
            print(lines[-1], flush=True)
    if options.output:
        options.output.write_text('\n'.join(lines) + '\n')


if __name__ == '__main__':
    main()
