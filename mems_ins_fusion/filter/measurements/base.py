"""What a measurement declares in its file of this folder, for whoever needs to know it."""
from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import dataclass

import numpy as np

from ...navigation.frames import FLU_TO_FRD
from ...parameters.parameter import Parameter

TWIST = 'geometry_msgs/msg/TwistWithCovarianceStamped'
ODOMETRY = 'nav_msgs/msg/Odometry'
POSE = 'geometry_msgs/msg/PoseWithCovarianceStamped'
POSE_STAMPED = 'geometry_msgs/msg/PoseStamped'
IMU = 'sensor_msgs/msg/Imu'
NAV_SAT_FIX = 'sensor_msgs/msg/NavSatFix'
GPS_FIX = 'gps_msgs/msg/GPSFix'


@dataclass(frozen=True)
class SensorSettings:
    """Of a measurement besides the fixes. sigma: 0 takes what the message says, default_sigma where it says nothing.
    offset: what is known of its constant error (`Measurement.offset`). factor: makes SI units of what messages say.
    time_offset: s, by which stamps are late against the IMU's clock, of what is of the antenna beside gnss.time_offset.
    turn: those of its turn rate, None where it has none.
    """

    topic: str
    sigma: float
    default_sigma: float
    offset: float = 0.0
    factor: float = 1.0
    time_offset: float = 0.0
    turn: SensorSettings | None = None


class Measurement:
    """One input of one kind of measurement: the plain one, or one with a name (`named`).

    Its file has `observe`, the compiled half, too (see `__init__`).

    kind: its number, one of its own. name: of its parameters (`NAME_topic`, `NAME.sigma`) and of its samples in a
    recording. samples: their class. unit: of the values. topic_text: description of `NAME_topic`. default_sigma: of
    what messages do not tell. offset: parameter `NAME.offset` that the samples' constant error is known by, '' without.
    components: of the innovation that are judged together. messages: ROS types that carry it, each with the fields
    that `read` needs, the first one being that which is written. layouts: of message types that no other part of the
    package reads: (field, NumPy type of an element, number of elements) behind the header. written_to: topic in
    recordings that are made here. of_antenna: whether it is of the GNSS antenna, and its stamps are the receiver's.
    from_satellites: whether an outage withholds it. of_two: whether each sample needs two messages. has_arm: whether it
    matters where in the vehicle it is measured.
    simulated_with: rate (Hz; 0: not there) and errors of a simulated
    one, by the names of `simulation.Aiding`.
    Of an input: number, `kind` of the plain one; state: name of its own optional state, '' without; arm: (3,) m from
    the IMU to where it is measured, body axes, of a named one.
    """

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
    has_arm = False
    arm: np.ndarray = np.zeros(3)
    simulated_with: Mapping[str, float] = {}

    number = property(lambda self: self.kind if self.is_plain else self._number)
    is_plain = property(lambda self: not hasattr(self, '_number'))
    state = ''

    def named(self, name: str, number: int, arm=(0.0, 0.0, 0.0)) -> Measurement:
        """An input of this kind with a name, a number and settings of its own. arm: base_link, forward-left-up, m."""
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
        """Name of the parameter with its topic."""
        return f'{self.name}_topic' if self.is_plain else f'{self.name}.topic'

    @property
    def topic_parameter(self) -> Parameter:
        return Parameter(self.topic, '', 'text', f'{self.topic_text}; empty: none.')

    def parameters(self) -> tuple[Parameter, ...]:
        """Those beside its topic."""
        return (
            Parameter(f'{self.name}.sigma', 0.0, self.unit, f'Standard deviation of the {self.name}; 0 takes what the '
                      'message says.', minimum=0.0, maximum=1000.0),
            Parameter(f'{self.name}.default_sigma', self.default_sigma, self.unit, 'Used where the message does not '
                      'tell.', positive=True, maximum=1000.0),
            Parameter(f'{self.name}.time_offset', 0.0, 's', f'By which the stamps on {self.topic} are late against the '
                      'IMU\'s clock' + (', beside gnss.time_offset.' if self.of_antenna and self.is_plain else '.'),
                      minimum=-10.0, maximum=10.0))

    def settings(self, values: Mapping) -> SensorSettings:
        """From checked parameters."""
        return SensorSettings(values[self.topic], values[f'{self.name}.sigma'], values[f'{self.name}.default_sigma'],
                              values[f'{self.name}.{self.offset}'] if self.offset else 0.0,
                              values.get(f'{self.name}.factor', 1.0), values[f'{self.name}.time_offset'])

    def states(self, values: Mapping) -> dict[str, tuple[float, float]]:
        """Optional states that it needs, of each the standard deviation that it starts with, 0: it is left out; and how
        it wanders, as a random walk in its unit per root of a second, 0: as a mounting does."""
        return {}

    def declared(self, settings: SensorSettings, samples):
        """`samples` in SI units and of base_link, as the `settings` make them of what the messages say."""
        return samples

    def records(self, settings: SensorSettings, samples) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Records (n, Event.SIZE) of `samples`, why each cannot be used ('' where it can), and warnings."""
        raise NotImplementedError

    def off(self, measured: float, innovation: np.ndarray) -> str:
        """How far a measurement was from what was expected, in words; innovation: expected minus measured."""
        return f'{self.name} {np.hypot(*innovation):.2f} {self.unit} off'

    def read(self, fields: Mapping[str, np.ndarray], message: str):
        """The samples of messages of the type `message`; fields: arrays over messages, and `stamp` and `received`."""
        raise NotImplementedError

    def written(self, samples) -> dict[str, np.ndarray]:
        """The fields of messages of the first of `messages`."""
        raise NotImplementedError

    def simulated(self, drive, errors: Mapping[str, float], effects, rng, instants):
        """The samples of a simulated drive (`simulation.drive.Drive`).

        errors: values of `simulated_with`. effects: pairs of effect and its values. instants: called with a rate, Hz,
        and a phase, s (None: that of the receiver's fixes); times (n,) s and stamps (n,) ns.
        """
        raise NotImplementedError

    def seen_from(self, samples, to_sensor):
        """Simulated `samples`, made in the axes of base_link, as a sensor in those of the IMU has them; to_sensor:
        scipy's Rotation to these."""
        return samples


def covariance36(elements: dict, count: int) -> np.ndarray:
    """(count, 36) with the elements given by their place, zero elsewhere."""
    covariance = np.zeros((count, 36))
    for place, values in elements.items():
        covariance[:, place] = values
    return covariance
