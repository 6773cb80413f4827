"""Publishes what the filter did with each measurement on ~/verdicts, and the refused fixes for display on maps."""
from __future__ import annotations

import math
from collections import deque

from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PointStamped
from rclpy.node import Node
from sensor_msgs.msg import NavSatFix

from ..filter.runs.live import FusionFilter
from .estimates import NO_EVENTS
from .geographic import to_local_point, world_frame
from .inputs import stamp_of
from .status import verdict

#: number of used fixes over which the NIS is averaged
_NIS_COUNT = 100
#: number of newest fixes that are kept until the filter has decided on them, which takes gnss.max_delay at most
_FIXES_KEPT = 50
#: ns, largest difference of two equal stamps, of which one was converted to the filter's seconds and back
_SAME_STAMP = 1000


class Verdicts:
    """Publishes what `fusion` did with the measurements. values: checked parameters of the node."""

    def __init__(self, node: Node, fusion: FusionFilter, values: dict):
        self._name, self._fusion, self._frame = node.get_name(), fusion, world_frame(values)
        self._fixes: deque[NavSatFix] = deque(maxlen=_FIXES_KEPT)
        self._nis: deque[float] = deque(maxlen=_NIS_COUNT)
        self._verdicts = node.create_publisher(DiagnosticArray, '~/verdicts', 1000, **NO_EVENTS)
        self._refused_fixes = node.create_publisher(NavSatFix, '~/refused_fixes', 50, **NO_EVENTS)
        self._refused_points = node.create_publisher(PointStamped, '~/refused_points', 50, **NO_EVENTS)

    @property
    def mean_nis(self) -> float | None:
        """Mean NIS of the latest fixes that were used; None before the first."""
        return sum(self._nis) / len(self._nis) if self._nis else None

    def keep(self, fix: NavSatFix) -> None:
        """Keep a fix until the filter has decided on it."""
        self._fixes.append(fix)

    def publish(self) -> None:
        """Publish the verdicts since the last call."""
        for judged in self._fusion.verdicts():
            self._verdicts.publish(verdict(self._name, judged))
            if judged.kind == 'fix' and judged.used:
                self._nis.append(judged.nis)
            elif judged.kind == 'fix':
                self._show_refused(judged.stamp)

    def _show_refused(self, stamp: int) -> None:
        """Publish the refused fix with this stamp, ns, in the clock of the IMU."""
        offset = round(self._fusion.config.parameters['gnss.time_offset'] * 1e9)
        message = next((fix for fix in self._fixes if abs(stamp_of(fix) - stamp - offset) < _SAME_STAMP), None)
        if message is None:
            return
        self._refused_fixes.publish(message)
        if self._fusion.datum is not None and math.isfinite(message.latitude + message.longitude + message.altitude):
            point = PointStamped(point=to_local_point(message, self._fusion.datum))
            point.header.stamp, point.header.frame_id = message.header.stamp, self._frame
            self._refused_points.publish(point)
