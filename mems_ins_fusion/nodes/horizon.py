"""Publishes the trust horizon on ~/horizon, latched, each second: for how long and how far the position stays accurate
without fixes."""
from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node

from ..filter.runs.horizon import Horizon
from ..filter.runs.live import FusionFilter
from ..samples import SECOND
from .estimates import LATCHED, NO_EVENTS
from .status import array, horizon_status

#: ns between two messages, by the stamps of the samples, so that a replay at any speed gives the same messages
_PERIOD = SECOND


class HorizonOutput:
    """Publishes the trust horizon of `fusion`. values: checked parameters of the node."""

    def __init__(self, node: Node, fusion: FusionFilter, values: dict):
        self._name, self._fusion, self._limit = node.get_name(), fusion, values['horizon.limit']
        self._publisher = node.create_publisher(DiagnosticArray, '~/horizon', LATCHED, **NO_EVENTS)
        self._slot, self._trusted = None, False  # slot of the newest message, and whether it contains a horizon

    def on_sample(self, now: int) -> None:
        """The filter has an estimate from a sample with the stamp `now`, ns."""
        slot = now // _PERIOD
        if slot != self._slot:
            self._slot = slot
            self._say(now, self._fusion.horizon())

    def stop(self, now: int) -> None:
        """There is no estimate any more at `now`, ns: publish that the last horizon is not valid."""
        if self._trusted:
            self._say(now, None)

    def _say(self, now: int, horizon: Horizon | None) -> None:
        self._publisher.publish(array(now, [horizon_status(self._name, horizon, self._limit)]))
        self._trusted = horizon is not None
