"""The filter. All files that declare columns (columns.py) are imported here, always in this order."""
from .trust import standstill, imu_faults, white_noise, drift, lag, scale  # noqa: F401, I001
from .trust import hypotheses, fix_drift, receiver, extrapolation  # noqa: F401, I001
from .measurements import time_offset, wheel_vibration, pressure, twist, magnetometer  # noqa: F401, I001
from .trust import imu_share  # noqa: F401, I001
from . import bank  # noqa: F401, I001
