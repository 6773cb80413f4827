"""All measurements there are: who needs them asks here."""
from __future__ import annotations

from ...parameters.parameter import Parameter
from . import wheel_vibration
from .base import Measurement
from .heading import Heading
from .position import Fix
from .speed import Speed
from .velocity import Velocity

#: those besides the fixes, in the order in which their parameters are written
AIDING: tuple[Measurement, ...] = (Speed(), Velocity(), Heading())
#: all, by their number
MEASUREMENTS: dict[int, Measurement] = {measurement.kind: measurement for measurement in (Fix(), *AIDING)}
#: parameters of what the samples of the IMU tell besides motion: no message brings it
HEARD: tuple[Parameter, ...] = (wheel_vibration.PARAMETER,)
NAMES = {kind: measurement.name for kind, measurement in MEASUREMENTS.items()}
assert len(MEASUREMENTS) == 1 + len(AIDING), 'two measurements with one number'
