"""How the filter is, for people and their tools: diagnostic_msgs/DiagnosticArray once a second and for each fix."""
from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

_SECOND = 10**9  # ns
#: states of the filter in which all is as it should be
GOOD_STATES = ('aligning', 'fusing')
#: those without an estimate
BEFORE_START = ('waiting', 'aligning')


def level_of(state: str) -> bytes:
    """OK, WARN or ERROR for a state of the filter."""
    if state in GOOD_STATES:
        return DiagnosticStatus.OK
    return DiagnosticStatus.ERROR if state == 'recovering' else DiagnosticStatus.WARN


def diagnostics(stamp: int, name: str, state: str, since: float, health: dict) -> DiagnosticArray:
    """The filter's state for /diagnostics. stamp: ns. since: s that `state` has lasted. health: of the filter."""
    waiting = health.get('waiting_for', '')
    message = f'{state} for {since:.0f} s' + (f': waiting for {waiting}' if waiting else '')
    status = DiagnosticStatus(level=level_of(state), name=f'{name}: filter', message=message, hardware_id=name,
                              values=_key_values({'state': state, 'state_for_s': since, **health}))
    return _array(stamp, [status])


def verdict(name: str, told: dict) -> DiagnosticArray:
    """What became of one measurement, stamped with its own time; numbers that plot tools draw over time.

    A DiagnosticArray carries a stamp, numbers and a reason in one standard message: used (0, 1), weight, nis and the
    innovation's components.
    """
    innovation = told['innovation']
    parts = {'innovation_north': innovation[0], 'innovation_east': innovation[1]} if len(innovation) == 2 else {
        f'innovation_{i}': value for i, value in enumerate(innovation)}
    refused = not told['used']
    level = DiagnosticStatus.WARN if refused or told['weight'] < 1.0 else DiagnosticStatus.OK
    message = f"refused: {told['reason']}" if refused else told['reason'] or 'used'
    numbers = {'used': int(told['used']), 'weight': told['weight'], 'nis': told['nis'], **parts}
    status = DiagnosticStatus(level=level, name=f"{name}: {told['kind']}", message=message, hardware_id=name,
                              values=_key_values(numbers))
    return _array(told['stamp'], [status])


def _array(stamp, statuses):
    array = DiagnosticArray(status=statuses)
    array.header.stamp.sec, array.header.stamp.nanosec = divmod(int(stamp), _SECOND)
    return array


def _key_values(values, prefix=''):
    pairs = []
    for key, value in values.items():
        if isinstance(value, dict):
            pairs += _key_values(value, f'{prefix}{key}.')
        else:
            text = f'{value:.9g}' if isinstance(value, float) else str(value)
            pairs.append(KeyValue(key=f'{prefix}{key}', value=text))
    return pairs
