"""The filter. Whatever is imported of it, the mechanisms that place columns in its memory come first, in this order."""
from .trust import imu_faults, standstill, white_noise, drift, lag, scale, receiver, straight_on  # noqa: F401, I001
from .measurements import wheel_vibration, pressure, twist, magnetometer  # noqa: F401, I001
