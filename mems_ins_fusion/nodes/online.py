"""The diagnosis while driving, in a process of its own: what it finds on ~/calibration and in the log."""
from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
from collections import deque
from queue import Full, Queue

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile

from ..diagnosis.gathering import CHUNK, Gathering
from ..diagnosis.quantity import FINE, INITIALISING, SUSPECT, Quantity
from .estimates import NO_EVENTS
from .log import Log
from .status import array, quantity_status

_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
#: s, that the process has to end in
_PATIENCE = 5.0


class OnlineDiagnosis:
    """Feeds the process and says what it answers. values: checked parameters of the node.

    Nothing here waits: chunks are pickled and written, and answers read, by threads.
    """

    def __init__(self, node: Node, values: dict, log: Log):
        self._name, self._log = node.get_name(), log
        self._gathering = Gathering()
        self._chunks: Queue = Queue(maxsize=max(int(values['diagnosis.window'] / CHUNK), 2))
        self._answers: deque[list[Quantity] | str] = deque()
        self._said: dict[str, tuple] = {}
        self._known: list[Quantity] = []
        self._publisher = node.create_publisher(DiagnosticArray, '~/calibration', _LATCHED, **NO_EVENTS)
        self._process = subprocess.Popen(
            [sys.executable, '-m', 'mems_ins_fusion.diagnosis.worker', str(values['diagnosis.share']),
             str(os.getpid())], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            env={**os.environ, 'OMP_NUM_THREADS': '1'})
        for target, argument in ((self._write, values), (self._read, None)):
            threading.Thread(target=target, args=(argument,), daemon=True).start()

    def add_sample(self, sample: tuple) -> None:
        """Stamp (ns), specific force and angular rate of the IMU, as the filter has them."""
        chunk = self._gathering.add_sample(sample)
        if chunk is not None:
            try:
                self._chunks.put_nowait(chunk)
            except Full:
                self._log.say('warning', 'diagnosis.online: samples left out, the process is too far behind '
                                         '(diagnosis.share)')

    def add_fix(self, fix: tuple) -> None:
        """What the filter has of a fix."""
        self._gathering.add_fix(fix)

    def add(self, name: str, stamp: int, numbers: tuple) -> None:
        """One of the other measurements."""
        self._gathering.add(name, stamp, numbers)

    def _write(self, values: dict) -> None:
        try:
            pickle.dump(values, self._process.stdin)
            while True:
                pickle.dump(self._chunks.get().recording(), self._process.stdin)
                self._process.stdin.flush()
        except OSError:  # `_read` tells
            pass

    def _read(self, _) -> None:
        try:
            while True:
                self._answers.append(pickle.load(self._process.stdout))
        except (EOFError, OSError, ValueError):
            self._answers.append(f'its process has ended ({self._process.wait()})')

    def look(self) -> list[DiagnosticStatus]:
        """Publish and log what is new; the statuses for /diagnostics. Once a second."""
        while self._answers:
            answer = self._answers.popleft()
            if isinstance(answer, str):
                self._log.tell('error', f'diagnosis.online: {answer}: nothing is diagnosed any more')
                self._known = []
                continue
            self._known = answer
            self._say(answer)
            if answer:
                self._publisher.publish(array(answer[0].time, self._statuses()))
        return self._statuses()

    def _say(self, answer: list[Quantity]) -> None:
        for quantity in answer:
            if self._said.get(quantity.name) != quantity.said and quantity.state != INITIALISING:
                level = 'warning' if quantity.state in (FINE, SUSPECT) else 'info'
                self._log.tell(level, f'diagnosis.online: {quantity.name} {quantity.state}: {quantity.text}')
            self._said[quantity.name] = quantity.said

    def _statuses(self) -> list[DiagnosticStatus]:
        return [quantity_status(self._name, quantity) for quantity in self._known]

    def close(self) -> None:
        """End the process."""
        self._process.terminate()
        try:
            self._process.wait(_PATIENCE)
        except subprocess.TimeoutExpired:
            self._process.kill()
