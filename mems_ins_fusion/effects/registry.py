"""All effects by name: a new one is one new module and one line here."""
from __future__ import annotations

from collections.abc import Mapping

from mems_ins_fusion.effects.accelerometer_lever_arm import AccelerometerLeverArm
from mems_ins_fusion.effects.accelerometer_scale import AccelerometerScale
from mems_ins_fusion.effects.aiding_lag import LAGS, AidingLag
from mems_ins_fusion.effects.aiding_time_offset import AND, TIME_OFFSETS, SeveralTimeOffsets, time_offset_of
from mems_ins_fusion.effects.base import Effect
from mems_ins_fusion.effects.g_sensitivity import GSensitivity
from mems_ins_fusion.effects.gnss_coloured_noise import GnssColouredNoise
from mems_ins_fusion.effects.gnss_lag import GnssLag
from mems_ins_fusion.effects.gnss_latency import GnssLatency
from mems_ins_fusion.effects.gnss_lever_arm import GnssLeverArm
from mems_ins_fusion.effects.gnss_outliers import GnssOutliers
from mems_ins_fusion.effects.gnss_time_offset import GnssTimeOffset
from mems_ins_fusion.effects.gyroscope_scale import GyroscopeScale
from mems_ins_fusion.effects.gyroscope_warm_up import GyroscopeWarmUp
from mems_ins_fusion.effects.imu_jitter import ImuJitter
from mems_ins_fusion.effects.imu_repeats import ImuRepeats
from mems_ins_fusion.effects.mounting_rotation import MountingRotation
from mems_ins_fusion.effects.odometry_yaw import OdometryYaw
from mems_ins_fusion.effects.pressure_dynamic import PressureDynamic
from mems_ins_fusion.effects.rear_axle import RearAxle
from mems_ins_fusion.effects.sideslip import Sideslip
from mems_ins_fusion.effects.speed_scale import SpeedScale
from mems_ins_fusion.effects.temperature import Temperature
from mems_ins_fusion.effects.tilt import Tilt

EFFECTS: dict[str, Effect] = {effect.name: effect for effect in (
    GnssTimeOffset(), GnssLeverArm(), GnssColouredNoise(), AccelerometerScale(), GyroscopeScale(), MountingRotation(),
    Tilt(), GSensitivity(), Temperature(), AccelerometerLeverArm(), Sideslip(),
    GnssLag(), GnssLatency(), RearAxle(), SpeedScale(), *TIME_OFFSETS,
    *LAGS, OdometryYaw('twist'), PressureDynamic('pressure'), GyroscopeWarmUp(), GnssOutliers(),
    ImuRepeats(), ImuJitter(),
)}
#: effects of an input, by the ends of their names and of the parameters that an input has which can have them
_OF_INPUT = {'_lag': ('lag', AidingLag), '_yaw': ('yaw', OdometryYaw), '_dynamic': ('dynamic', PressureDynamic)}
_OFFSET_OF = '_time_offset'


def effects_of(values: Mapping) -> tuple[Effect, ...]:
    """All, and those of the inputs that the checked parameters `values` name."""
    names = values.get('inputs', ())
    return (*EFFECTS.values(), *(time_offset_of(name) for name in names),
            *(effect(name) for parameter, effect in _OF_INPUT.values() for name in names
              if f'{name}.{parameter}' in values))


def effect_called(name: str) -> Effect:
    """The effect `name`; one without words where there is none of that name."""
    if name in EFFECTS:
        return EFFECTS[name]
    for end, (_, effect) in _OF_INPUT.items():
        if name.endswith(end):
            return effect(name.removesuffix(end))
    if not name.endswith(_OFFSET_OF):
        return Effect()
    inputs = name.removesuffix(_OFFSET_OF).split(AND)
    return time_offset_of(*inputs) if len(inputs) == 1 else SeveralTimeOffsets(dict.fromkeys(inputs, 0.0))
