"""Reports on filter and inputs, once a second: in the log and on /diagnostics."""
from __future__ import annotations

import time
from collections import deque

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node

from ..filter.runs.imus import Imus
from ..filter.runs.live import FusionFilter
from ..filter.runs.tally import Tally
from .aiding_check import AidingCheck
from .estimates import NO_EVENTS
from .inputs import Input
from .log import Log, StateLog
from .mounting_check import MountingCheck
from .online import OnlineDiagnosis
from .preflight import Preflight
from .status import BEFORE_START, ERROR, SILENT, WARN, InputStatus, array, by_the_clock, filter_status, level_of
from .verdicts import Verdicts

#: s between two reports
PERIOD = 1.0
#: s: messages that are delayed by more than others show that the machine is busy
_LONG_WAIT = 0.1
_WRONG_MOUNTING = 'nothing is published with a mounting that is certainly wrong'
#: level of the logger for each level of a status
_LOG_LEVELS = {b'\x00': 'info', b'\x01': 'warning', b'\x02': 'error'}


class Monitor:
    """Reports on `fusion` and `inputs` (the IMU and the fixes first). values: checked parameters of the node.

    mounting, aiding, preflight: checks that the node gives each message.
    """

    def __init__(self, node: Node, fusion: FusionFilter, inputs: list[Input], verdicts: Verdicts, values: dict,
                 log: Log, online: OnlineDiagnosis | None = None, imus: Imus | None = None):
        self._imus = imus
        self._node, self._fusion, self._inputs, self._verdicts, self._log = node, fusion, inputs, verdicts, log
        self._imu, self._online = inputs[0], online
        self._all_imus = [source for source in inputs if source.is_imu]
        self.mounting, self.aiding = MountingCheck(values), AidingCheck(values)
        self._statuses = [InputStatus(source) for source in inputs]
        self.preflight = Preflight(inputs, values)
        self._state_log = StateLog()
        self._said_standstills = False
        self._cannot_start: int | None = None  # stamp of the sample since which the filter cannot start, ns
        self._looked = time.monotonic()
        # s by which the last two reports were late: messages lost in a stall are noticed in the messages after it
        self._stalled = deque([0.0], maxlen=2)
        self._diagnostics = node.create_publisher(DiagnosticArray, '/diagnostics', 10, **NO_EVENTS)

    def look(self) -> None:
        """Once in PERIOD."""
        now = time.monotonic()
        self._stalled.append(now - self._looked - PERIOD)
        self._looked = now
        for source in self._inputs:
            source.look()
        for status in self._statuses:
            status.look(self._tally(status.input))
            self._say_lost(status)
        self._look_at_mounting()
        for name, level, text in self.aiding.look():
            topic = next(source.topic_name for source in self._inputs if source.name == name)
            self._log.tell(level, f'{topic}: {text}')
        self._say_silent()
        self._diagnose()
        found = self.preflight.look(self.mounting.force())
        if found:
            self._log.tell(*found)

    def _tally(self, source: Input) -> Tally:
        if self._imus and source.name in self._imus.names[1:]:
            return self._imus.tallies[source.name]
        return self._fusion.tallies.get(source.name) or Tally()

    def _say_lost(self, status: InputStatus) -> None:
        if status.lost:
            waited = max(status.waited, *self._stalled)
            why = (f'others came up to {waited:.1f} s late: the machine is busy' if waited > _LONG_WAIT
                   else 'on their way: the network or the publisher is busy')
            self._log.say('warning', f'{status.input.topic_name}: {status.lost} messages lost in the last second, '
                                     f'{why}')

    def _look_at_mounting(self) -> None:
        found = self.mounting.look()
        if found:
            level, text = found
            self._log.tell(level, f'{self._imu.topic_name}: {text}')
            if self.mounting.is_certainly_wrong:
                self._fusion.reset()
        if self.mounting.standstills and not self._said_standstills:
            level, text = self.mounting.standstills
            self._log.tell(level, f'{self._imu.topic_name}: {text}')
            self._said_standstills = True

    def _say_silent(self) -> None:
        for source in self._inputs:
            found = source.traffic.check()
            if found is None:
                continue
            silent, seconds = found
            if silent:
                self._log.tell('warning', f'no message on {source.topic_name} ({source.kind}) for {seconds:.0f} s: '
                                          f'{source.why_silent()}')
            else:
                self._log.tell('info', f'messages on {source.topic_name} again after {seconds:.0f} s')

    def _diagnose(self) -> None:
        """State, reasons and numbers, for the log and /diagnostics."""
        state, reasons, health = self._judge()
        certain = self.mounting.is_certainly_wrong
        level = ERROR if certain else level_of(state, self._cannot_start_for())
        # the mounting that was found is in the line of the look that has found it
        logged = reasons[:1] if certain and len(reasons) > 1 else reasons
        since, said = self._state_log.look(state, '; '.join(logged) or health['status'], level)
        if said:
            self._log.tell(_LOG_LEVELS[level], said)
        for source in self._inputs:
            if source.name in self._found:
                reasons, level = [*reasons, f'{source.topic_name}: {self._found[source.name][1]}'], max(level, WARN)
        if self.mounting.is_wrong and not certain:  # else that is the reason
            reasons, level = [*reasons, self.mounting.found], max(level, WARN)
        if self.mounting.standstills and self.mounting.standstills[0] != 'info':
            reasons, level = [*reasons, self.mounting.standstills[1]], max(level, WARN)
        if self._verdicts.mean_nis is not None:
            health['mean NIS'] = self._verdicts.mean_nis
        health['mounting'] = self.mounting.found
        for source in self._inputs:
            health[f'messages on {source.topic_name}, Hz'] = source.traffic.hertz
        name = self._node.get_name()
        statuses = [filter_status(name, state, level, since, reasons, health),
                    *(self._input_status(name, status, health) for status in self._statuses),
                    *(self._online.look() if self._online else [])]
        self._diagnostics.publish(array(self._node.get_clock().now().nanoseconds, statuses))

    @property
    def _found(self) -> dict[str, tuple[str, str]]:
        """Level and text of the present problem of each input, by its name."""
        return {**self.aiding.found, **(self._imus.found if self._imus else {})}

    def _judge(self) -> tuple[str, list[str], dict]:
        """State, reasons and numbers of the filter, by the clock."""
        state, health, reasons = self._fusion.state, self._fusion.health(), self._fusion.reasons
        last = min(self._all_imus, key=lambda source: source.traffic.silence)
        imu = last.traffic
        if imu.is_stale and imu.count:
            return (SILENT, [f'no sample on {last.topic_name} for {imu.silence:.0f} s, nothing is published'],
                    by_the_clock(health, imu.silence))
        if self.mounting.is_certainly_wrong:
            reasons = [f'{self._imu.topic_name}: {_WRONG_MOUNTING}', self.mounting.found]
        elif state in BEFORE_START:
            reasons = [health['status']]
        elif state == 'coasting':
            reasons = [f"no fix used for {health['age of the last fix used, s']:.0f} s", *self._left(health), *reasons]
        return state, reasons, health

    @staticmethod
    def _left(health: dict) -> list[str]:
        """Remaining time of the trust horizon in an outage, in words."""
        left, limit = health['trust horizon, s'], health['trust horizon to, m']
        return [f'the error stays below {limit:g} m for {left:.0f} s more' if left > 0.0 else
                f'the error may be larger than {limit:g} m']

    def _input_status(self, name: str, status: InputStatus, health: dict) -> DiagnosticStatus:
        source, age, more = status.input, 'age of the last fix used, s', {}
        if source.name == 'imu':
            more = {'gaps': self._fusion.gaps}
        elif source.name == 'fix' and age in health:
            more = {age: health[age]}
        return status.status(name, self._tally(source), self._found.get(source.name), more)

    def _cannot_start_for(self) -> float:
        """Time, s, by the stamps of the samples, for which the filter has waited although waiting does not help."""
        now = max(source.traffic.stamp for source in self._all_imus)
        if not self._fusion.contradicted:
            self._cannot_start = None
        elif self._cannot_start is None or now < self._cannot_start:  # the clock was set back
            self._cannot_start = now
        return 0.0 if self._cannot_start is None else (now - self._cannot_start) * 1e-9
