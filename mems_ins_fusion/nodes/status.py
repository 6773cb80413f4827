"""Status of filter and inputs as diagnostic_msgs/DiagnosticArray, once a second."""
from __future__ import annotations

import math
from collections import deque

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from ..diagnosis.quantity import FindingState
from ..filter.runs.horizon import Horizon
from ..filter.runs.tally import Tally
from ..samples import SECOND
from .inputs import Input

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
#: states of the filter without a problem
GOOD_STATES = ('aligning', 'fusing')
#: states of the filter without an estimate
BEFORE_START = ('waiting', 'aligning')
#: state of the node: the samples have stopped, so that there is no estimate any more
SILENT = 'silent'
_BAD_STATES = ('recovering', SILENT)
#: s after which a filter that cannot start is reported as a warning: the first samples may be wrong
CANNOT_START_WARNING = 5.0
#: s after which it is reported as an error
CANNOT_START_ERROR = 30.0
#: s over which the share of refused messages is counted
RECENT = 10
#: share of refused messages above which there is a warning
MUCH = 0.1
#: m/s^2, standard deviation of the acceleration of the vehicle while there are no samples. Chosen, not measured
_UNKNOWN_ACCELERATION = 1.0
_COMPONENTS = {1: ('innovation',), 2: ('innovation_north', 'innovation_east')}


def level_of(state: str, cannot_start: float = 0.0) -> bytes:
    """OK, WARN or ERROR for a state of the filter. cannot_start: s for which the filter has not been able to start."""
    if state in _BAD_STATES or cannot_start > CANNOT_START_ERROR:
        return ERROR
    return OK if state in GOOD_STATES and cannot_start <= CANNOT_START_WARNING else WARN


def filter_status(name: str, state: str, level: bytes, since: float, reasons: list[str], health: dict
                  ) -> DiagnosticStatus:
    """The status of the filter. since: s for which `state` has lasted. reasons: why it is not good, in words."""
    lasted = f' for {since:.0f} s' if since >= 1.0 else ''
    message = f"{state}{lasted}{': ' if reasons else ''}{'; '.join(reasons)}"
    return DiagnosticStatus(level=level, name=f'{name}: filter', message=message, hardware_id=name,
                            values=_key_values({**health, 'state': state, 'state for, s': since}))


def by_the_clock(health: dict, silence: float) -> dict:
    """`health` of a filter whose newest sample came `silence` s ago, with ages and sigmas that have grown since.

    The vehicle is assumed to go on with a speed that changes by _UNKNOWN_ACCELERATION.
    """
    grown = dict(health)
    if 'age of the last fix used, s' in grown:
        grown['age of the last fix used, s'] += silence
    if 'trust horizon, s' in grown:
        grown['trust horizon, s'] = max(grown['trust horizon, s'] - silence, 0.0)
    if 'position sigma, m' in grown:
        grown['position sigma, m'] = math.hypot(grown['position sigma, m'], grown['speed sigma, m/s'] * silence,
                                                0.5 * _UNKNOWN_ACCELERATION * silence**2)
    return grown


class InputStatus:
    """The status of one input on /diagnostics, `look` once a second."""

    def __init__(self, source: Input):
        self.input, self.lost, self.waited = source, 0, 0.0
        self._recent: deque[tuple[int, int]] = deque(maxlen=RECENT)
        self._before = 0, 0

    def look(self, tally: Tally) -> None:
        """Update from the messages since the last call."""
        total = self._used(tally), sum(tally.refused.values())
        used, refused = (now - before for now, before in zip(total, self._before))
        self._before = total
        self._recent.append((used, refused) if used >= 0 and refused >= 0 else (0, 0))  # negative after a restart
        self.lost, self.waited = self.input.traffic.look(self.input.publishers())

    def _used(self, tally: Tally) -> int:
        """Number of messages used. The filter does not count the samples of the IMU: nearly all are used."""
        return self.input.traffic.count - sum(tally.refused.values()) if self.input.name == 'imu' else tally.used

    def status(self, name: str, tally: Tally, problem: tuple[str, str] | None, more: dict) -> DiagnosticStatus:
        """The status of the input. problem: level ('warning' or 'error') and text of a certain problem, or None."""
        traffic = self.input.traffic
        level, message = self._verdict(tally, problem)
        values = {'topic': self.input.topic_name, 'type': self.input.kind, 'frame': traffic.frame_id,
                  'messages': traffic.count, 'rate, Hz': traffic.hertz, 'silent for, s': traffic.silence,
                  'delay, s': traffic.delay, 'lost': traffic.lost, 'waited in the queue, s': self.waited,
                  'used': self._used(tally), **{f'refused, {reason}': n for reason, n in tally.refused.items()},
                  'realised over claimed': tally.misfit, **more}
        return DiagnosticStatus(level=level, name=f'{name}: {self.input.name}', message=message,
                                hardware_id=self.input.topic_name, values=_key_values(values))

    def _verdict(self, tally, problem) -> tuple[bytes, str]:
        traffic = self.input.traffic
        if traffic.is_stale:
            return ERROR, (f'no message for {traffic.silence:.0f} s' if traffic.count else
                           f'no message yet: {self.input.why_silent()}')
        if not traffic.count:
            return WARN, 'no message yet'
        used, refused = (sum(column) for column in zip(*self._recent))
        steadily = refused > 2 and not used
        said = [f'{tally.reason}: all of the last {refused} refused'] if steadily else []
        level = ERROR if steadily else OK
        if not steadily and refused > MUCH * (used + refused):
            said.append(f'{refused} of the last {used + refused} refused, the last one: {tally.reason}')
            level = WARN
        if self.lost:
            said.append(f'{self.lost} messages lost in the last second')
            level = max(level, WARN)
        if problem is not None:
            said.insert(0, problem[1])
            level = max(level, ERROR if problem[0] == 'error' else WARN)
        return level, '; '.join(said) or f'{traffic.hertz:.1f} Hz'


def verdict(name: str, judged) -> DiagnosticArray:
    """What the filter did with one measurement, stamped with the measurement's time; plot tools can show the numbers.

    A DiagnosticArray has a stamp, numbers and a reason in one standard message: used (0, 1), weight, nis and the
    components of the innovation.
    """
    names = _COMPONENTS[len(judged.innovation)]
    numbers = {'used': int(judged.used), 'weight': judged.weight, 'nis': judged.nis,
               **dict(zip(names, judged.innovation))}
    level = OK if judged.used and judged.weight == 1.0 else WARN
    message = judged.reason if judged.used else f'refused: {judged.reason}'
    status = DiagnosticStatus(level=level, name=f'{name}: {judged.kind}', message=message, hardware_id=name,
                              values=_key_values(numbers))
    return array(judged.stamp, [status])


def horizon_status(name: str, horizon: Horizon | None, limit: float) -> DiagnosticStatus:
    """The status of the trust horizon to `limit`, m. horizon: None while there is no estimate with a heading."""
    seconds, metres = horizon or (0.0, 0.0)
    said = f'without fixes the error stays below {limit:g} m for {horizon.in_words}' if seconds > 0.0 else (
        f'the error may be larger than {limit:g} m now' if horizon else 'no estimate with a heading')
    return DiagnosticStatus(level=OK if seconds > 0.0 else WARN, name=f'{name}: horizon', message=f'{said} (95 %)',
                            hardware_id=name, values=_key_values({'seconds': seconds, 'metres': metres,
                                                                  'limit, m': limit}))


def quantity_status(name: str, quantity: FindingState) -> DiagnosticStatus:
    """The status of one quantity of the diagnosis while driving."""
    values: dict = {'state': quantity.state}
    for parameter, estimate in quantity.parameters.items():
        unit = '' if estimate.unit == '-' else f', {estimate.unit}'
        values |= {f'{parameter}{unit}': estimate.value, f'{parameter} sigma{unit}': estimate.sigma}
    for duration, (without, with_it, count) in quantity.better.items():
        said = f'error after {duration:g} s without fixes, m'
        values |= {f'{said}, without it': without, f'{said}, with it': with_it, f'{said}, times': count}
    values |= {f'set {i}': line for i, line in enumerate(quantity.sets, 1)}
    values |= {'applied': quantity.applied} | ({'to know it better': quantity.advice} if quantity.advice else {})
    level = WARN if quantity.is_to_look_at else OK
    return DiagnosticStatus(level=level, name=f'{name}: calibration: {quantity.name}', hardware_id=name,
                            message=f'{quantity.state}: {quantity.text}', values=_key_values(values))


def array(stamp: int, statuses: list[DiagnosticStatus]) -> DiagnosticArray:
    """The message of `statuses`; stamp: ns."""
    message = DiagnosticArray(status=statuses)
    message.header.stamp.sec, message.header.stamp.nanosec = divmod(int(stamp), SECOND)
    return message


def _key_values(values):
    return [KeyValue(key=key, value=f'{value:.9g}' if isinstance(value, float) else str(value))
            for key, value in values.items()]
