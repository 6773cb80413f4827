"""The diagnosis while driving, in a process of its own; its findings are on ~/calibration and in the log."""
from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
from collections import deque
from dataclasses import replace
from functools import partial
from queue import Full, Queue

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from std_srvs.srv import Trigger

from ..diagnosis.applying import AnswerSchedule
from ..diagnosis.gathering import CHUNK, Gathering
from ..diagnosis.quantity import INITIALISING, SUSPECT, EarlierFinding, FilterFindings, FindingState
from ..filter.measurements.registry import aiding
from ..filter.runs.changing import Dropped
from .estimates import LATCHED, NO_EVENTS
from .log import Log
from .status import array, quantity_status

#: why the diagnosis is behind, for messages
_BUSY = 'the computer is busy, or diagnosis.share is too small'


class OnlineDiagnosis:
    """Sends data to the process and reports its answers. values: checked parameters of the node. kept: findings of
    earlier drives.

    No method waits: threads pickle and write the chunks of data, and read the answers.
    """

    def __init__(self, node: Node, values: dict, log: Log, kept: list[EarlierFinding]):
        self._name, self._log = node.get_name(), log
        self._keeps = values['diagnosis.online'] == 'apply'
        self._due = AnswerSchedule({one.name: one.sets for one in kept})
        self._gathering = Gathering(aiding(values))
        self._chunks: Queue = Queue(maxsize=max(int(values['diagnosis.window'] / CHUNK), 2))
        self._answers: deque[tuple[int, list[FindingState]] | str] = deque()  # with the number of the chunk
        self._dropped: list[Dropped] = []  # since the last chunk
        self._kept = kept  # findings that are applied, for the next start
        self._said: dict[str, tuple] = {}
        self._known: list[FindingState] = []
        self._publisher = node.create_publisher(DiagnosticArray, '~/calibration', LATCHED, **NO_EVENTS)
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'mems_ins_fusion.diagnosis.worker', str(values['diagnosis.share']),
             str(os.getpid())], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env={**os.environ, 'OMP_NUM_THREADS': '1'})
        for target, arguments in ((self._write, ({**values}, kept)), (self._read, ())):
            threading.Thread(target=target, args=arguments, daemon=True).start()
        for word in ('accept', 'reject', 'reset'):
            node.create_service(Trigger, f'~/calibration/{word}', partial(self._on_word, word))
        node.create_service(Trigger, '~/calibration/report', self._on_report)

    def add_sample(self, sample: tuple) -> FilterFindings | None:
        """Add a sample: stamp (ns), specific force and angular rate, as for the filter. Returns the findings to apply
        from this sample on, if they have changed."""
        chunk = self._gathering.add_sample(sample)
        if chunk is None:
            findings = self._due.asked()
            if findings is not None:
                self._hear()  # the state file is written with `kept` at once
            return findings
        findings = self._due.at_end_of_chunk()
        if self._due.late:
            self._log.say('info', f'diagnosis.online: {self._due.late * CHUNK:.0f} s behind the drive: {_BUSY}. '
                                  'Findings are reported and applied this much later')
        try:
            self._chunks.put_nowait((chunk, self._dropped))
            self._dropped = []
            self._due.handed()
        except Full:
            self._log.say('warning', f'diagnosis.online: too far behind: {_BUSY}. {CHUNK:.0f} s of samples are left '
                                     'out')
        return findings

    def add_fix(self, fix: tuple) -> None:
        """Add a fix, as for the filter."""
        self._gathering.add_fix(fix)

    def add(self, name: str, stamp: int, numbers: tuple) -> None:
        """Add a measurement of another input."""
        self._gathering.add(name, stamp, numbers)

    def dropped(self, one: Dropped) -> None:
        """Note that the filter has dropped a finding, which is not to be applied again."""
        self._due.dropped(one.name)
        self._dropped.append(one)
        self._known = _without({one.name}, self._known)
        self._kept = [kept for kept in self._kept if kept.name != one.name]

    @property
    def kept(self) -> list[EarlierFinding] | None:
        """The findings that are applied, for the next start; None if a start would not apply them."""
        return self._kept if self._keeps else None

    def ask(self, word: str) -> bool:
        """Send the command `word` (accept, reject or reset) to the diagnosis; False if it is too far behind for it."""
        try:
            self._chunks.put_nowait(word)
        except Full:
            return False
        return True

    def _on_word(self, word: str, request, response):
        response.success = self.ask(word)
        response.message = f'calibration: {word}: ' + (
            'passed on; the result is on ~/calibration' if response.success else
            f'not done, the diagnosis is too far behind: {_BUSY}')
        return response

    def _on_report(self, request, response):
        response.success = True
        response.message = '\n'.join(f'{q.name} {q.sentence}' for q in self._known) or 'nothing known yet'
        return response

    def _write(self, values: dict, kept: list[EarlierFinding]) -> None:
        try:
            pickle.dump((values, kept), self._process.stdin)
            self._process.stdin.flush()
            while True:
                asked = self._chunks.get()
                message = asked if isinstance(asked, str) else (asked[0].recording(), asked[1])
                pickle.dump(message, self._process.stdin)
                self._process.stdin.flush()
        except OSError:  # reported by `_read`
            pass

    def _read(self) -> None:
        number = -1
        try:
            while True:
                quantities, findings, is_chunk = pickle.load(self._process.stdout)
                number += is_chunk
                self._answers.append((number, quantities))  # before it counts, see `add_sample`
                self._due.answered(findings, is_chunk)
        except (EOFError, OSError, ValueError):
            self._answers.append(f'its process has ended ({self._process.wait()})')

    def look(self) -> list[DiagnosticStatus]:
        """Publish and log new answers; returns the statuses for /diagnostics. Called once a second."""
        self._hear()
        return self._statuses()

    def _hear(self) -> None:
        while self._answers:
            answer = self._answers.popleft()
            if isinstance(answer, str):
                self._log.tell('error', f'diagnosis.online: {answer}: nothing is diagnosed any more')
                self._known = []
                continue
            number, quantities = answer
            before, self._known = self._known, _without(self._due.unknown_to(number), quantities)
            known = self._known
            self._kept = [quantity.kept for quantity in known if quantity.applied]
            self._say(known)
            if known or before:  # also that nothing is known any more
                self._publisher.publish(array((known or before)[0].time, self._statuses()))

    def _say(self, answer: list[FindingState]) -> None:
        for quantity in answer:
            if self._said.get(quantity.name) != quantity.said and quantity.state != INITIALISING:
                level = 'warning' if quantity.is_to_look_at else 'info'
                self._log.tell(level, f'diagnosis.online: {quantity.name} {quantity.sentence}'
                                     f'{". To know it better: " if quantity.advice else ""}{quantity.advice}')
            self._said[quantity.name] = quantity.said

    def _statuses(self) -> list[DiagnosticStatus]:
        return [quantity_status(self._name, quantity) for quantity in self._known]

    def close(self) -> None:
        """Have the process end. It is not waited for: it also ends by itself when this one has ended."""
        self._process.terminate()


def _without(dropped: set[str], quantities: list[FindingState]) -> list[FindingState]:
    """`quantities` where the filter has dropped some of them."""
    return [replace(q, applied=False, state=SUSPECT) if q.applied and q.name in dropped else q for q in quantities]
