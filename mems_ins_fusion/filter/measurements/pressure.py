"""Height from air pressure by the standard atmosphere. Weather and geoid are a slow bias: only changes of height count.

The air flow past a moving vehicle changes the pressure by a share of the dynamic pressure, rho v^2 / 2: a third less in
a cabin with open windows, a third more in a duct at the front. This is an error of the height of the share times
v^2 / (2 g), which is 20 m at 20 m/s. The share is a state.

Source: U.S. Standard Atmosphere, 1976 (NOAA-S/T 76-1562), eq. 33a: the layer up to 11 km, in geopotential height, which
differs from height by 1 m in 2500 m.
"""
from __future__ import annotations

from dataclasses import replace

import numpy as np

from mems_ins_fusion.compiled import njit

from ...navigation.earth import STANDARD_GRAVITY
from ...parameters.parameter import Parameter
from ...samples import Pressures
from ..memory import NAV, Error, Event, Head, Kind, Nav, input_at, velocity_variance
from ..trust.scale import Noise, Scale
from .base import Measurement
from .events import empty, refuse, stated_or
from .geometry import add
from .time_offset import add_time_offset

#: s for which an error of the velocity lasts. It causes nearly the same error in all pressures of that time, so
#: together they have the weight of one. Chosen, not measured
VELOCITY_ERROR_TIME = 10.0


@njit(_nrt=False)
def _add_second_order(mem, r, at, share, state):
    """Set R of the event at `at` to the variance of the pressure plus that of the second-order terms, which H does not
    contain: (error of share) x (error of velocity), and (error of velocity)^2.

    state: index of the share among the states. P is in the scratch.
    """
    n = int(mem[Head.N_NAVIGATION]) + int(mem[Head.N_AUGMENTED])
    unknown = mem[int(mem[Head.SCRATCH_AT]) + (n + 1) * state]
    speeds = velocity_variance(mem, r) / STANDARD_GRAVITY**2
    squared = mem[r + Nav.V_N] ** 2 + mem[r + Nav.V_E] ** 2
    more = unknown * squared * speeds + 0.5 * (share * share + unknown) * (STANDARD_GRAVITY * speeds) ** 2
    since = mem[at + Event.TIME] - mem[input_at(mem, r, at) + Noise.SCALE + Scale.TIME]
    mem[at + Event.R_NN] = mem[at + Event.VALUE + 2] + max(1.0, VELOCITY_ERROR_TIME / max(since, 1e-3)) * more


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    """Height, positive up; one component."""
    north, east, share = mem[r + Nav.V_N], mem[r + Nav.V_E], mem[at + Event.VALUE + 1]
    flow = 0.5 * (north * north + east * east) / STANDARD_GRAVITY
    mem[at + Event.Z_N] = mem[r + Nav.HEIGHT] - share * flow - mem[at + Event.VALUE]
    add(mem, h, Error.R_D, -1.0)
    add_time_offset(mem, at, h, -mem[r + Nav.V_D])
    bias = int(mem[at + Event.STATE])
    if bias >= 0:
        mem[h + bias], mem[h + bias + 1] = -1.0, flow
        share += mem[r + NAV + bias + 1]
        _add_second_order(mem, r, at, share, bias + 1)
    add(mem, h, Error.V_N, -share * north / STANDARD_GRAVITY)
    add(mem, h, Error.V_E, -share * east / STANDARD_GRAVITY)
    return 1


SEA_LEVEL = 101325.0  # Pa, of the standard atmosphere at sea level
SCALE_HEIGHT = 288.15 / 0.0065  # m: temperature at sea level (K) over lapse rate (K/m)
#: gas constant times lapse rate, over gravity times molar mass
PRESSURE_EXPONENT = 8.31432 * 0.0065 / (9.80665 * 0.0289644)
LOWEST_PRESSURE = 40000.0  # Pa, smallest pressure on land: the highest road is at 5900 m
HIGHEST_PRESSURE = 115000.0  # Pa, largest pressure: the lowest mine is 500 m below the sea
SMALLEST_SIGMA = 0.1  # Pa, lower limit of the standard deviation of a pressure, whatever the message states


def is_air(pressure: np.ndarray) -> np.ndarray:
    """(n,) whether `pressure` (n,), Pa, can be that of the air on land; false for NaN."""
    return (pressure >= LOWEST_PRESSURE) & (pressure <= HIGHEST_PRESSURE)


def height_of(pressure: np.ndarray) -> np.ndarray:
    """Height (n,), m, at which the standard atmosphere has `pressure` (n,), Pa."""
    return SCALE_HEIGHT * (1.0 - (pressure / SEA_LEVEL) ** PRESSURE_EXPONENT)


def pressure_at(height: np.ndarray) -> np.ndarray:
    """Inverse of `height_of`."""
    return SEA_LEVEL * (1.0 - height / SCALE_HEIGHT) ** (1.0 / PRESSURE_EXPONENT)


def metres_per_pascal(pressure: np.ndarray) -> np.ndarray:
    """Height gained for each pascal less, m/Pa, at `pressure` (n,), Pa."""
    return SCALE_HEIGHT * PRESSURE_EXPONENT / SEA_LEVEL * (pressure / SEA_LEVEL) ** (PRESSURE_EXPONENT - 1.0)


class Pressure(Measurement):
    observe = staticmethod(observe)
    kind, name, samples, unit, default_sigma = Kind.PRESSURE, 'pressure', Pressures, 'Pa', 12.0
    topic_text = 'Topic of the pressure of the air, Pa: sensor_msgs/FluidPressure (strapdown)'
    messages = {'sensor_msgs/msg/FluidPressure': ('fluid_pressure', 'variance')}
    layouts = {'sensor_msgs/msg/FluidPressure': (('fluid_pressure', '<f8', 1), ('variance', '<f8', 1))}
    written_to, needs_height, offset = '/pressure', True, 'dynamic'
    #: Pa, white noise; m, standard deviation of the height's bias, drawn for each seed; m/sqrt(s), its random walk
    simulated_with = {'pressure_rate': 0.0, 'pressure_sigma': 5.0, 'pressure_bias': 80.0, 'pressure_walk': 0.05}

    def parameters(self):
        return (
            *super().parameters(),
            self.factor_parameter('Pa', '100 for hPa', 1e6),
            Parameter(f'{self.name}.bias_sigma', 300.0, 'm', 'Initial standard deviation of the error of the height by '
                      'pressure: weather and geoid.', minimum=1.0, maximum=1e4),
            Parameter(f'{self.name}.bias_walk', 0.1, 'm/sqrt(s)', 'Random walk of that error: weather, temperature, '
                      'ventilation of the vehicle.', minimum=0.0, maximum=100.0),
            Parameter(f'{self.name}.dynamic', 0.0, '-', 'Share of the dynamic pressure, half the density of air times '
                      'the square of the speed, that is measured in addition: positive where the air is held up, '
                      'negative where it is drawn out.', minimum=-2.0, maximum=2.0),
            Parameter(f'{self.name}.dynamic_sigma', 0.3, '-', 'Standard deviation of what is left of that share, which '
                      'is estimated.', minimum=1e-6, maximum=2.0))

    def states(self, values):
        return {self.state: (values[f'{self.name}.bias_sigma'], values[f'{self.name}.bias_walk']),
                f'{self.name}_dynamic': (values[f'{self.name}.dynamic_sigma'], 0.0)}

    @property
    def state(self):
        return f'{self.name}_bias'

    def declared(self, settings, pressures):
        return replace(pressures, pressure=settings.factor * pressures.pressure,
                       variance=settings.factor**2 * pressures.variance)

    def events(self, settings, pressures):
        pressures = self.declared(settings, pressures)
        n, pressure = len(pressures), pressures.pressure
        r, reasons = empty(Kind.PRESSURE, n), {}
        possible = is_air(pressure)
        refuse(reasons, ~possible, lambda i: f'pressure {pressure[i]:g} Pa is outside {LOWEST_PRESSURE:g} to '
               f'{HIGHEST_PRESSURE:g} Pa: dropped (a wrong {self.name}.factor?)')
        there = np.where(possible, pressure, SEA_LEVEL)
        r[:, Event.VALUE], r[:, Event.VALUE + 1] = height_of(there), settings.offset
        r[:, Event.R_NN] = stated_or(pressures.variance, settings, SMALLEST_SIGMA) * metres_per_pascal(there) ** 2
        r[:, Event.VALUE + 2] = r[:, Event.R_NN]
        return r, reasons, {}

    def off(self, measured, innovation):
        return f'the height by pressure is {abs(innovation[0]):.1f} m off'

    def read(self, fields, message):
        return Pressures(stamp=fields['stamp'], received=fields['received'], pressure=fields['fluid_pressure'],
                         variance=fields['variance'])

    def written(self, pressures):
        return {'fluid_pressure': pressures.pressure, 'variance': pressures.variance}

    def simulated(self, drive, errors, effects, rng, instants):
        time, stamp = instants(errors['pressure_rate'], 0.0037)
        steps = rng.standard_normal(len(time))
        bias = errors['pressure_bias'] * rng.standard_normal() + errors['pressure_walk'] * np.cumsum(
            steps * np.sqrt(np.diff(time, prepend=time[:1])))
        speed = np.interp(time, drive.time, np.hypot(drive.velocity[:, 0], drive.velocity[:, 1]))
        share = sum(effect.dynamic_pressure(self.name, values) for effect, values in effects)
        less = share * speed**2 / (2.0 * STANDARD_GRAVITY)
        pressure = pressure_at(np.interp(time, drive.time, drive.height) + bias - less)
        sigma = errors['pressure_sigma']
        return Pressures(stamp, stamp.copy(), pressure + sigma * rng.standard_normal(len(time)),
                         np.full(len(time), sigma**2))
