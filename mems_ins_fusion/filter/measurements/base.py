"""Base class of the measurements in this folder: what each of them declares about itself."""
from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from ...navigation.frames import FLU_TO_FRD
from ...parameters.parameter import Parameter

#: types of the messages that measurements come in
TWIST = 'geometry_msgs/msg/TwistWithCovarianceStamped'
ODOMETRY = 'nav_msgs/msg/Odometry'
POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
POSE_STAMPED = 'geometry_msgs/msg/PoseStamped'
IMU = 'sensor_msgs/msg/Imu'
NAV_SAT_FIX = 'sensor_msgs/msg/NavSatFix'
NOT_THERE = (-1.0, *[0.0] * 8)  # covariance that sensor_msgs/Imu states for a quantity that the message does not hold
FIRST_NAMED = 100  # number of the first named input
#: s, standard deviation of the time offset of stamps that is not configured: a bus, a serial line and a filter in the
#: sensor together delay a measurement by tenths of a second
UNDECLARED_OFFSET = 0.1
#: m, largest standard deviation of the place of the axle sideways and up: vehicles are longer than wide and high
BESIDE_AXLE = 1.0


def beside_axle_sigma(values: Mapping) -> float:
    """Standard deviation of the lateral and of the vertical component of vehicle.rear_axle, m."""
    return min(values['vehicle.rear_axle_sigma'], BESIDE_AXLE)


@dataclass(frozen=True)
class SensorSettings:
    """Settings of any input but the fixes.

    sigma: standard deviation; 0: that of the message, or default_sigma where the message has none. offset: value of the
    parameter that `Measurement.offset` names. factor: SI units per unit of the messages. time_offset: s by which the
    stamps are later than the IMU's clock; for measurements at the GNSS antenna, in addition to gnss.time_offset. lag:
    time constant of the low pass that it comes through, s. yaw: rad, by which an odometry is turned to the left. turn:
    settings of the turn rate, None where the input has none.
    """

    topic: str
    sigma: float
    default_sigma: float
    offset: float = 0.0
    factor: float = 1.0
    time_offset: float = 0.0
    lag: float = 0.0
    yaw: float = 0.0
    turn: SensorSettings | None = None


class Measurement:
    """One input: the unnamed one of a kind of measurement (`is_plain`), or a named one (`NAME.type`, made by `named`).

    observe: the compiled function in the same file (see `__init__`). kind: unique number. name: prefix of the
    parameters (`NAME_topic`, `NAME.sigma`), and name of the samples in a recording. samples: their class. unit: of the
    values. topic_text: description of `NAME_topic`. default_sigma: default of `NAME.default_sigma`. offset: name of the
    parameter for a known constant error (such as `NAME.offset` or `NAME.scale`), '' without. components: number of
    components of the innovation that are tested together. messages: ROS types that carry it, each with the fields that
    `read` needs; recordings are written with the first type. layouts: for message types that no other part of the
    package reads: (field, NumPy type of an element, number of elements) of each field after the header. written_to:
    topic in recordings that this package writes. of_antenna: whether it is measured at the GNSS antenna, with the
    receiver's stamps. from_satellites: whether it is withheld in an outage. of_two: whether a sample is computed from
    two messages. needs_height: whether it can only be used with a mechanization that has a height. has_arm: whether it
    depends on where in the vehicle it is measured. has_lag: whether the filter knows a low pass that it comes through
    (`NAME.lag`). simulated_with: rate (Hz; 0: not simulated) and errors in simulations, by the names of
    `simulation.Aiding`.

    Of an input: number, equal to `kind` for the unnamed one; state: name of its first optional state, '' without; arm:
    lever arm (3,) from the IMU, body axes, m, of a named one.
    """

    observe: Callable
    kind: int
    name: str
    samples: type
    unit: str
    topic_text: str
    default_sigma: float
    offset = ''
    components = 1
    messages: Mapping[str, Sequence[str]]
    layouts: Mapping[str, Sequence[tuple[str, str, int]]] = {}
    written_to: str
    of_antenna = False
    from_satellites = False
    of_two = False
    needs_height = False
    has_arm = False
    has_lag = False
    arm: np.ndarray = np.zeros(3)
    simulated_with: Mapping[str, float] = {}

    number = property(lambda self: self.kind if self.is_plain else self._number)
    is_plain = property(lambda self: not hasattr(self, '_number'))
    state = ''

    @property
    def time_offset_state(self) -> str:
        """Name of the state for the time offset that remains beside the configured one."""
        return f'{self.name}_time_offset'

    def named(self, name: str, number: int, arm=(0.0, 0.0, 0.0)) -> Measurement:
        """A named input of this kind. arm: lever arm, base_link (forward-left-up), m."""
        other = copy(self)
        other.name, other._number, other.arm = name, number, FLU_TO_FRD @ np.asarray(arm, dtype=float)
        return other

    def named_parameters(self) -> tuple[Parameter, ...]:
        """All parameters of a named input."""
        arm = Parameter(f'{self.name}.lever_arm', [0.0, 0.0, 0.0], 'm', 'From the IMU to where it is measured, '
                        'base_link (forward-left-up).', lengths=(3,), minimum=-50.0, maximum=50.0)
        return (Parameter(f'{self.name}.type', '', 'text', 'What it measures.'),
                Parameter(self.topic, '', 'text', f'{self.topic_text}.', positive=True),
                *self.parameters(), *((arm,) if self.has_arm else ()))

    @property
    def topic(self) -> str:
        """Name of the parameter that holds the topic."""
        return f'{self.name}_topic' if self.is_plain else f'{self.name}.topic'

    @property
    def topic_parameter(self) -> Parameter:
        return Parameter(self.topic, '', 'text', f'{self.topic_text}; empty: none.')

    def parameters(self) -> tuple[Parameter, ...]:
        """All parameters but the topic's."""
        lag = Parameter(f'{self.name}.lag', 0.0, 's', f'Time constant of a low pass in the sensor, its driver or the '
                        f'bus, which is a part of {self.name}.time_offset.', minimum=0.0, maximum=10.0)
        return (
            Parameter(f'{self.name}.sigma', 0.0, self.unit, f'Standard deviation of the {self.name}; 0: that of the '
                      'message.', minimum=0.0, maximum=1000.0),
            Parameter(f'{self.name}.default_sigma', self.default_sigma, self.unit, 'Standard deviation where the '
                      'message has none.', positive=True, maximum=1000.0),
            Parameter(f'{self.name}.time_offset', 0.0, 's', f'By which the stamps on {self.topic} are late against the '
                      'IMU\'s clock' + (', in addition to gnss.time_offset.' if self.of_antenna and self.is_plain else
                                        '.'), minimum=-10.0, maximum=10.0),
            Parameter(f'{self.name}.time_offset_sigma', UNDECLARED_OFFSET, 's', f'Standard deviation of what is left '
                      f'beside {self.name}.time_offset, which is estimated; 0: nothing is left.', minimum=0.0,
                      maximum=10.0), *((lag,) if self.has_lag else ()))

    def factor_parameter(self, unit: str, examples: str, largest: float = 1e4) -> Parameter:
        """`NAME.factor`. unit: to which it converts."""
        return Parameter(f'{self.name}.factor', 1.0, '-', f'Converts the values on {self.topic} to {unit}: {examples}.',
                         minimum=-largest, maximum=largest)

    def settings(self, values: Mapping) -> SensorSettings:
        """From checked parameters."""
        return SensorSettings(values[self.topic], values[f'{self.name}.sigma'], values[f'{self.name}.default_sigma'],
                              values[f'{self.name}.{self.offset}'] if self.offset else 0.0,
                              values.get(f'{self.name}.factor', 1.0), values[f'{self.name}.time_offset'],
                              values[f'{self.name}.lag'] if self.has_lag else 0.0)

    def states(self, values: Mapping) -> dict[str, tuple[float, float]]:
        """Optional states, each with its initial standard deviation (0: left out) and its random walk, unit/sqrt(s)
        (0: that of a mounting angle, `config.MOUNTING_WANDER`)."""
        return {}

    def axle_states(self, values: Mapping) -> dict[str, tuple[float, float]]:
        """The lateral offset of the axle from the IMU, as `states`, of wheels without a lever arm of their own: in a
        bend it changes their speed. All of them share it."""
        return {'axle_y': (beside_axle_sigma(values), 0.0)} if self.is_plain else {}

    def declared(self, settings: SensorSettings, samples):
        """`samples` converted by the settings (units, sign, known constant error)."""
        return samples

    def events(self, settings: SensorSettings, samples) -> tuple[np.ndarray, dict[int, str], dict[int, str]]:
        """Events (n, Event.SIZE) of `samples`; for samples that cannot be used, the reason by index; and warnings by
        index."""
        raise NotImplementedError

    def off(self, measured: float, innovation: np.ndarray) -> str:
        """The innovation (predicted minus measured) in words."""
        return f'{self.name} {np.hypot(*innovation):.2f} {self.unit} off'

    def read(self, fields: Mapping[str, np.ndarray], message: str):
        """Samples from messages of the type `message`. fields: an array over the messages for each field, `stamp` and
        `received`."""
        raise NotImplementedError

    def written(self, samples) -> dict[str, np.ndarray]:
        """Fields of messages of the first type in `messages`."""
        raise NotImplementedError

    def simulated(self, drive, errors: Mapping[str, float], effects, rng, instants):
        """Samples of a simulated drive (`simulation.drive.Drive`).

        errors: values of `simulated_with`. effects: pairs of an effect and its parameters. instants(rate, phase), with
        rate in Hz and phase in s (None: that of the fixes), returns times (n,) s and stamps (n,) ns.
        """
        raise NotImplementedError

    def seen_from(self, samples, to_sensor):
        """Simulated `samples` in the axes of base_link, converted to those of the IMU by the scipy Rotation
        `to_sensor`.
        """
        return samples


def covariance36(elements: dict, count: int) -> np.ndarray:
    """(count, 36): covariances that are zero but for `elements`, values by index in the row-major 6 x 6 matrix."""
    covariance = np.zeros((count, 36))
    for index, values in elements.items():
        covariance[:, index] = values
    return covariance
