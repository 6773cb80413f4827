"""How the filter is, for people and their tools: diagnostic_msgs/DiagnosticArray once a second and for each fix."""
from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

_SECOND = 10**9  # ns
#: states of the filter in which all is as it should be
GOOD_STATES = ('aligning', 'fusing')
#: those without an estimate
BEFORE_START = ('waiting', 'aligning')
_COMPONENTS = dict.fromkeys(('fix', 'velocity'), ('innovation_north', 'innovation_east'))


def level_of(state: str) -> bytes:
    """OK, WARN or ERROR for a state of the filter."""
    if state in GOOD_STATES:
        return DiagnosticStatus.OK
    return DiagnosticStatus.ERROR if state == 'recovering' else DiagnosticStatus.WARN


def diagnostics(stamp: int, name: str, state: str, since: float, health: dict, problem: str = '') -> DiagnosticArray:
    """The filter's state for /diagnostics. stamp: ns. since: s that `state` has lasted. health: of the filter. problem:
    what is wrong whatever the state."""
    why = f": {health['status']}" if state in BEFORE_START else ''
    why += f'; {problem}' if problem else ''
    level = max(level_of(state), DiagnosticStatus.WARN if problem else DiagnosticStatus.OK)
    status = DiagnosticStatus(level=level, name=f'{name}: filter', message=f'{state} for {since:.0f} s{why}',
                              hardware_id=name, values=_key_values({**health, 'state for, s': since}))
    return _array(stamp, [status])


def verdict(name: str, judged) -> DiagnosticArray:
    """What became of one measurement, stamped with its own time; numbers that plot tools draw over time.

    A DiagnosticArray carries a stamp, numbers and a reason in one standard message: used (0, 1), weight, nis and the
    innovation's components.
    """
    names = _COMPONENTS.get(judged.kind, ('innovation',))
    numbers = {'used': int(judged.used), 'weight': judged.weight, 'nis': judged.nis,
               **dict(zip(names, judged.innovation))}
    level = DiagnosticStatus.OK if judged.used and judged.weight == 1.0 else DiagnosticStatus.WARN
    message = judged.reason if judged.used else f'refused: {judged.reason}'
    status = DiagnosticStatus(level=level, name=f'{name}: {judged.kind}', message=message, hardware_id=name,
                              values=_key_values(numbers))
    return _array(judged.stamp, [status])


def _array(stamp, statuses):
    array = DiagnosticArray(status=statuses)
    array.header.stamp.sec, array.header.stamp.nanosec = divmod(int(stamp), _SECOND)
    return array


def _key_values(values):
    return [KeyValue(key=key, value=f'{value:.9g}' if isinstance(value, float) else str(value))
            for key, value in values.items()]
