"""Settings of the filter, computed from the parameters. The rest of the filter reads these settings, not parameters."""
from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..effects.registry import EFFECTS
from ..navigation import strapdown
from ..navigation.earth import STANDARD_GRAVITY
from ..navigation.frames import FLU_TO_FRD, mounting
from ..parameters.parameter import ParameterError
from ..sensor_errors.models import MODELS, GaussMarkov, Model, RandomWalk, per_axis
from .bank import Bank
from .history import history_size
from .measurements import wheel_vibration
from .measurements.base import Measurement, SensorSettings, beside_axle_sigma
from .measurements.registry import aiding, imus, inputs
from .memory import (
    BY_NAME,
    HEAD,
    MECHANIZATIONS,
    Error,
    Event,
    Head,
    Kind,
    Sample,
    StateLayout,
    count_states,
    noise_size,
    row_width,
    scratch_size,
)
from .prediction import TURN_TIME, Turns
from .trust import imu_share
from .trust.drift import DriftSettings
from .trust.imu_faults import Imu
from .trust.imu_share import Share
from .trust.lag import LagSettings
from .trust.scale import Inputs
from .trust.white_noise import White

#: s by which the stamp of a measurement may be later than the newest IMU sample when it arrives. A measurement that is
#: further ahead has stamps of another clock
AHEAD = 1.0
FASTEST_IMU = 1000  # Hz, IMU rate up to which the memory holds the samples of gnss.max_delay
#: Hz, rate of all measurements together up to which the memory holds those of gnss.max_delay: speed, velocity and
#: heading at 100 Hz, fixes at 20 Hz, and a margin
MOST_MEASUREMENTS = 400
SENSORS = ('accelerometer', 'gyroscope')  # first part of the names of their parameters
#: names of the optional states for the vehicle's axes in the body's: to the right, and up, rad
MOUNTING_STATES = 'mounting_yaw', 'mounting_pitch'
#: when an IMU is switched off and on, its constant errors change by this share of the standard deviation that an
#: unknown IMU has. Chosen, not measured
REPEATED_TURN_ON = 0.3
#: random walk of an estimated mounting angle in an hour, as a share of its prior standard deviation. Chosen, not
#: measured
MOUNTING_WANDER = 0.05
TILT_TIME = 30.0  # s, correlation time of the tilt of road and body, for the planar filter. Chosen, not measured


@dataclass(frozen=True)
class ImuSettings:
    """mounting_rpy: rad, as `imu.mounting_rpy`. max_gap, restart_gap: s. Largest values in SI units."""

    topic: str
    temperature_topic: str
    mounting_rpy: tuple[float, float, float]
    max_gap: float
    restart_gap: float
    max_specific_force: float
    max_angular_rate: float

    @property
    def mounting(self) -> np.ndarray:
        """Rotation from sensor to body axes, (3, 3)."""
        return mounting(self.mounting_rpy)


@dataclass(frozen=True)
class GnssSettings:
    """Settings of the main receiver.

    lever_arm: (3,) body axes forward-right-down, m. lever_arm_sigma: of it, forward and right, m. time_offset,
    max_delay, outage_after: s. lag: s^2, delay of the position in m for each m/s^2 of acceleration. sigma,
    default_sigma: m. gate: normalized innovation beyond which a fix is refused, 0: none. coloured: model of the
    receiver's coloured noise, or None.
    """

    topic: str
    lever_arm: np.ndarray
    lever_arm_sigma: float
    time_offset: float
    lag: float
    sigma: float
    default_sigma: float
    max_delay: float
    gate: float
    outage_after: float
    coloured: GaussMarkov | None

    @property
    def lag_time(self) -> float:
        """Time constant of the receiver's filter as trust/lag.py models it, s.

        A positive lag is that of a filter that tracks the velocity: lag = time^2. A negative lag is that of a low pass
        with the time constant tau: lag = -tau^2 / 2, and the time constant here is tau / 3.
        """
        return math.sqrt(self.lag if self.lag >= 0.0 else -2.0 * self.lag / 9.0)

    @property
    def lag_gain(self) -> float:
        """s: m by which a fix lags for each m/s of velocity that the receiver's filter has not followed yet."""
        return self.lag / self.lag_time if self.lag else 0.0


@dataclass(frozen=True)
class AlignmentSettings:
    """heading: source of the initial heading: course, orientation or parameter. yaw, yaw_sigma: rad. level: whether the
    samples are corrected for the tilt that is found at a standstill, for which the planar filter has no states.
    gyroscope_turn_on: rad/s, prior standard deviation of the gyroscope bias."""

    heading: str
    yaw: float
    yaw_sigma: float
    level: bool
    gyroscope_turn_on: float


@dataclass(frozen=True)
class VehicleSettings:
    """Settings of the vehicle constraints. zero_velocity_sigma, lateral_sigma: m/s; 0: the constraint is not used.
    still_acceleration: m/s^2. still_rate: rad/s."""

    zero_velocity_sigma: float
    lateral_sigma: float
    still_acceleration: float
    still_rate: float


@dataclass(frozen=True)
class Extra:
    """An optional state: its name, process model, and standard deviation at the start."""

    name: str
    model: RandomWalk | GaussMarkov
    initial_sigma: float


@dataclass(frozen=True)
class FilterConfig:
    """Settings of one filter. Axes are body axes unless a name says otherwise."""

    mechanization: int
    open_loop: bool
    models: tuple[Model, ...]  # one per channel of the mechanization
    white: np.ndarray  # (6,) noise densities squared
    turn_on_sigma: np.ndarray  # (channels,) of the constant bias outside the model
    conditioning: np.ndarray  # (6, 6): body-axis f, w = conditioning (raw f, w) + offset
    offset: np.ndarray  # (6,)
    extras: tuple[Extra, ...]
    imu: ImuSettings
    gnss: GnssSettings
    inputs: dict[int, Measurement]  # by number
    sensors: dict[int, SensorSettings]  # of all inputs but the main receiver's fixes, by number
    alignment: AlignmentSettings
    vehicle: VehicleSettings
    wheel_vibration: str  # off or report
    datum: np.ndarray | None  # rad, rad, m
    parameters: dict  # as given

    @classmethod
    def from_parameters(cls, values: dict) -> FilterConfig:
        """From checked parameters (`parameters.table.check`). Raises ParameterError where they contradict each other.
        """
        mechanization = BY_NAME[values['mechanization']]
        channels, is_level = MECHANIZATIONS[mechanization].CHANNELS, StateLayout(mechanization, 1).is_level
        for measurement in aiding(values) if is_level else ():
            if measurement.needs_height and values[measurement.topic]:
                raise ParameterError(f"parameter '{measurement.topic}' needs mechanization strapdown: planar has no "
                                     'height')
        rotation = mounting(values['imu.mounting_rpy'])
        mixing = np.kron(np.eye(2), rotation)
        along = np.abs(mixing).argmax(axis=1)  # the sensor axis that lies along each body axis

        def sensors(name):
            return np.concatenate([per_axis(values, f'{sensor}.{name}') for sensor in SENSORS])

        axes = [strapdown.CHANNELS.index(name) for name in channels]
        kind = MODELS[values['sensor_error_model']]
        by_sensor_axis = [model for sensor in SENSORS for model in kind.from_parameters(values, sensor)]
        models = tuple(by_sensor_axis[along[i]] for i in axes)
        turn_on = sensors('initial_sigma')
        constant = [0.0 if model.holds_turn_on else turn_on[along[i]] for i, model in zip(axes, models)]
        conditioning = mixing / (1.0 + sensors('scale'))
        for effect in EFFECTS.values():
            correction = effect.conditioning(values)
            if correction is not None:
                conditioning = correction @ conditioning
        white = mixing**2 @ sensors('noise_density')**2
        if is_level:
            models, white = _with_tilt(models, white, STANDARD_GRAVITY * values['vehicle.tilt_sigma'])
        datum = values['datum']
        return cls(
            mechanization=mechanization, open_loop=values['feedback'] == 'open', models=_equal_order(models),
            white=white, turn_on_sigma=np.array(constant), conditioning=conditioning,
            offset=-conditioning @ sensors('bias'), extras=_extras(values, is_level), imu=_imu(values),
            gnss=_gnss(values), inputs=inputs(values),
            sensors={measurement.number: measurement.settings(values) for measurement in aiding(values)},
            alignment=_alignment(values, is_level), vehicle=_vehicle(values),
            wheel_vibration=values['wheel_vibration'],
            datum=np.array([math.radians(datum[0]), math.radians(datum[1]), datum[2]]) if datum else None,
            parameters=values)

    def settings_of(self, number: int) -> GnssSettings | SensorSettings:
        """Settings of the input with this number."""
        return self.gnss if number == Kind.POSITION else self.sensors[number]

    def time_offset_of(self, number: int) -> float:
        """s, by which the stamps of the input with this number are late against the IMU's clock, without the part that
        a low pass makes (`measurements/low_pass.py`)."""
        measurement, own = self.inputs[number], self.settings_of(number).time_offset
        if number != Kind.POSITION:
            own -= self.sensors[number].lag
        of_receiver = measurement.of_antenna and measurement.is_plain and measurement.kind != Kind.POSITION
        return own + (self.gnss.time_offset if of_receiver else 0.0)

    @property
    def declared_errors(self) -> list[float]:
        """Configured factors, offsets and time offsets of the inputs in use. The filter's states are corrections to
        these."""
        return [value for settings in self.sensors.values() if settings.topic
                for value in (settings.factor, settings.offset, settings.time_offset, settings.lag,
                              settings.yaw)]

    @property
    def latest(self) -> float:
        """s by which a measurement may arrive after the IMU samples of its time: gnss.max_delay plus the time offset.
        """
        return self.gnss.max_delay + max(0.0, *map(self.time_offset_of, self.inputs))

    @property
    def ahead(self) -> float:
        """s by which a measurement may arrive before the IMU samples of its time: AHEAD plus the time offset."""
        return AHEAD + max(0.0, *(-self.time_offset_of(number) for number in self.inputs))

    @cached_property
    def layout(self) -> StateLayout:
        return StateLayout(self.mechanization, self.models[0].order, tuple(extra.name for extra in self.extras),
                           len(self._places))

    @cached_property
    def _places(self) -> dict[int, int]:
        """`Event.INPUT` of each input with a topic but the fixes, by its number."""
        return {number: place for place, number in enumerate(
            (number for number, settings in self.sensors.items() if settings.topic), start=1)}

    @cached_property
    def from_satellites(self) -> np.ndarray:
        """By `Event.INPUT`: 1 for measurements from satellites, which an outage withholds, else 0."""
        return np.array([float(self.inputs[number].from_satellites) for number in (Kind.POSITION, *self._places)])

    @property
    def _axle(self) -> np.ndarray:
        """(3,) m, from the IMU to the middle of the axle that does not steer."""
        return FLU_TO_FRD @ np.asarray(self.parameters['vehicle.rear_axle'], dtype=float)

    def of_input(self, number: int) -> np.ndarray:
        """Columns INPUT to INPUT_END of events of the input with this number. ParameterError where it has no topic."""
        measurement, columns = self.inputs[number], np.zeros(Event.SIZE)
        if not self.settings_of(number).topic:
            raise ParameterError(f"parameter '{measurement.topic}' is empty: the filter has no {measurement.name}")
        columns[Event.INPUT] = 0 if number == Kind.POSITION else self._places[number]
        columns[Event.STATE] = self.layout.index(measurement.state)
        columns[Event.TIME_OFFSET] = max(self.layout.index(measurement.time_offset_state), 0)
        columns[Event.AT_AXLE] = measurement.is_plain and not measurement.of_antenna
        columns[Event.ARM:Event.ARM + 3] = measurement.arm if not measurement.is_plain else (
            self.gnss.lever_arm if measurement.of_antenna else self._axle)
        columns[Event.LAG] = 0.0 if number == Kind.POSITION else self.sensors[number].lag
        return columns[Event.INPUT:Event.INPUT_END]

    @property
    def first_variance(self) -> np.ndarray:
        """Initial variance of the error of each channel (channels,), without calibration."""
        return np.array([model.initial_covariance()[0, 0] + turn_on**2
                         for model, turn_on in zip(self.models, self.turn_on_sigma)])

    @property
    def channel_axes(self) -> list[int]:
        """Which of f_x, f_y, f_z, w_x, w_y, w_z each channel is."""
        return [strapdown.CHANNELS.index(name) for name in self.layout.channels]

    @property
    def capacity(self) -> int:
        """Number of IMU samples kept: a power of two, and twice those that a late measurement makes the filter repeat,
        as it returns to an earlier state (`memory.kept_state`)."""
        return 2 * 2 ** math.ceil(math.log2(self.latest * FASTEST_IMU + 16))

    @property
    def event_capacity(self) -> int:
        """Number of measurements kept: twice those of the longest delay, as the older half is dropped at once."""
        return 2 * math.ceil(MOST_MEASUREMENTS * (self.latest + self.ahead))

    def correctors(self) -> list:
        """Functions that remove the configured effects from samples in sensor axes, in the order of application."""
        made = (effect.corrector(self.parameters, self.imu.mounting) for effect in EFFECTS.values())
        return [corrector for corrector in made if corrector is not None]

    def memory(self, history: bool = False) -> np.ndarray:
        """The kernel's memory with these settings, before the first state. history: with room for smoothing."""
        layout, width = self.layout, row_width(self.layout)
        rows = Head.SIZE + noise_size(layout)
        ring = rows + count_states(self.capacity) * width
        events = ring + self.capacity * Sample.SIZE
        scratch = events + self.event_capacity * Event.SIZE
        wheels = scratch + scratch_size(layout.n)
        end = wheels + (0 if self.wheel_vibration == 'off' else wheel_vibration.Lines.SIZE)
        # room for the second filter (bank.py); none in a smoother, and none where no fix is ever refused
        second = 0 if history or self.gnss.gate == 0.0 else end
        memory = np.zeros(end + second + (history_size(layout.n) if history else 0))
        HEAD.begin(memory)
        memory[Bank.SIZE] = second
        self._write_head(memory, width)
        for column, at in ((Head.ROWS_AT, rows), (Head.RING_AT, ring), (Head.EVENTS_AT, events),
                           (Head.SCRATCH_AT, scratch), (Head.HISTORY_AT, end if history else 0)):
            memory[column] = at
        memory[Head.SIZE:rows], memory[Head.FORGOTTEN] = self._noise(), -math.inf
        if wheels < end:
            wheel_vibration.begin(memory, wheels)
        return memory

    def _write_head(self, head: np.ndarray, width: int) -> None:
        layout, gnss, vehicle, values = self.layout, self.gnss, self.vehicle, self.parameters
        shows_tilt = not layout.is_level
        axle = self._axle
        settings = {
            Head.MECHANIZATION: self.mechanization, Head.OPEN_LOOP: self.open_loop,
            Head.N_NAVIGATION: layout.n_navigation, Head.N_AUGMENTED: layout.n_augmented, Head.ORDER: layout.order,
            Head.CHANNELS: len(self.models), Head.WIDTH: width, Head.CAPACITY: self.capacity,
            Head.EVENT_CAPACITY: self.event_capacity,
            Head.COLOURED: layout.index('coloured_n'), Head.MOUNTING_PITCH: layout.index('mounting_pitch'),
            Head.MOUNTING_YAW: layout.index('mounting_yaw'), Head.AXLE: layout.index('axle_x'),
            Head.AXLE_ACROSS: layout.index('axle_y'), Head.AXLE_BELOW: layout.index('axle_z'),
            Head.INTERVAL: self.models[0].interval or 0.0, Head.INTERVAL + 1: self.models[-1].interval or 0.0,
            Head.MAX_GAP: self.imu.max_gap, Head.MAX_DELAY: self.latest, Head.AHEAD: self.ahead,
            Head.GATE: gnss.gate, Head.ROBUST_SIGMA: values['gnss.robust_sigma'],
            Head.RECOVERY_TIME: values['gnss.recovery_time'], Head.COVARIANCE_FACTOR: values['gnss.adapt_covariance'],
            # in the planar filter, errors by slopes would count as errors of the receiver
            Head.ADAPT: values['gnss.adapt_sigma'] and shows_tilt,
            # with AR models the planar filter's white noise includes the tilt (`_with_tilt`)
            White.ADAPT: values['imu.adapt_noise'] and shows_tilt,
            DriftSettings.LEARNED: (values['vehicle.learn_drift'] and shows_tilt
                                    and values['sensor_error_model'] != 'autoregressive'),
            Turns.NOISE: TURN_TIME * values['gyroscope.scale_sigma'] ** 2,
            LagSettings.GAIN: gnss.lag_gain, LagSettings.TIME: gnss.lag_time,
            Head.LEVER_X: gnss.lever_arm[0], Head.LEVER_Y: gnss.lever_arm[1], Head.LEVER_Z: gnss.lever_arm[2],
            Head.AXLE_X: axle[0], Head.AXLE_Y: axle[1], Head.AXLE_Z: axle[2],

            Head.ZERO_VELOCITY_SIGMA: vehicle.zero_velocity_sigma, Head.LATERAL_SIGMA: vehicle.lateral_sigma,
            Head.VERTICAL_SIGMA: (values['vehicle.non_holonomic']
                                  * values['vehicle.non_holonomic_vertical_sigma']),
            Head.ANGLE_SIGMA: values['vehicle.non_holonomic_angle_sigma'],
            Head.SIDESLIP: values['vehicle.sideslip_per_acceleration'],
            Head.SLIP_SIGMA: values['vehicle.sideslip_sigma'], Inputs.COUNT: layout.inputs,
            Share.STATE: max(layout.index(imu_share.NAME), 0),
            Imu.MAX_FORCE: self.imu.max_specific_force, Imu.MAX_RATE: self.imu.max_angular_rate,
        }
        for column, value in settings.items():
            head[column] = value
        head[Head.CONDITIONING:Head.CONDITIONING + 36] = self.conditioning.T.ravel()
        head[Head.OFFSET:Head.OFFSET + 6] = self.offset
        head[Head.ROWS:Head.ROWS + Error.SIZE] = layout.rows
        head[Head.CHANNEL:Head.CHANNEL + 6] = layout.axes

    def _noise(self) -> np.ndarray:
        layout = self.layout
        decay, walk, variance = np.zeros((3, layout.n_augmented))
        coefficients = np.zeros((len(self.models), layout.order))
        driving = np.array([model.b0**2 for model in self.models])
        states = [channel * layout.order for channel in range(len(self.models))]
        for channel, model in enumerate(self.models):
            coefficients[channel, :len(model.coefficients)] = model.coefficients
        for state, model in zip([*states, *range(layout.n_sensor, layout.n_augmented)],
                                [*self.models, *(extra.model for extra in self.extras)]):
            decay[state], walk[state], variance[state] = model.decay, model.walk, model.variance
        return np.concatenate([self.white, decay, walk, variance, coefficients.ravel(), driving,
                               REPEATED_TURN_ON**2 * self.first_variance])


def _equal_order(models: tuple[Model, ...]) -> tuple[Model, ...]:
    """The models with the order of the largest, padded with zeros: the kernel has one p for all channels."""
    order = max(model.order for model in models)
    return tuple(model if model.order == order else model.of_order(order) for model in models)


def _with_tilt(models: tuple[Model, ...], white: np.ndarray, sigma: float) -> tuple[tuple[Model, ...], np.ndarray]:
    """Models and white noise of the planar filter, which has no state for tilt, with gravity leaking into f_x and f_y.

    sigma: m/s^2. Each model includes it in its own way (`Model.with_tilt`).
    """
    if sigma == 0:
        return models, white
    tilted, more = zip(*(model.with_tilt(sigma, TILT_TIME) for model in models[:2]))
    return (*tilted, models[2]), white + [*more, 0.0, 0.0, 0.0, 0.0]


def _extras(values: dict, is_level: bool) -> tuple[Extra, ...]:
    """The optional states of the configuration."""
    extras = []
    coloured = _coloured(values)
    if coloured:
        extras += [Extra(name, coloured, coloured.sigma) for name in ('coloured_n', 'coloured_e')]

    def slow(name, sigma, walk=0.0):
        if (sigma > 0 or walk > 0) and all(extra.name != name for extra in extras):
            walk = walk or MOUNTING_WANDER * sigma / math.sqrt(3600.0)
            extras.append(Extra(name, RandomWalk(walk, sigma), sigma))

    if values['vehicle.non_holonomic']:
        if not is_level:
            slow('mounting_pitch', values['imu.mounting_sigma'])
        slow('mounting_yaw', values['imu.mounting_sigma'])
        slow('axle_x', values['vehicle.rear_axle_sigma'])
        if not is_level:
            slow('axle_z', beside_axle_sigma(values))
    slow('time_offset', values['gnss.time_offset_sigma'], values['gnss.time_offset_walk'])
    for measurement in aiding(values):
        if values[measurement.topic]:
            for name, (sigma, walk) in measurement.states(values).items():
                slow(name, sigma, walk)
            slow(measurement.time_offset_state, values[f'{measurement.name}.time_offset_sigma'])
    if imus(values):
        extras.append(Extra(imu_share.NAME, RandomWalk(0.0, 0.0), 0.0))
    return tuple(extras)


def _coloured(values: dict) -> GaussMarkov | None:
    sigma = values['gnss.coloured_noise.sigma']
    return GaussMarkov(sigma, values['gnss.coloured_noise.tau']) if sigma > 0 else None


def _imu(values: dict) -> ImuSettings:
    return ImuSettings(values['imu_topic'], values['temperature_topic'], tuple(values['imu.mounting_rpy']),
                       values['imu.max_gap'], values['imu.restart_gap'], values['imu.max_specific_force'],
                       values['imu.max_angular_rate'])


def _gnss(values: dict) -> GnssSettings:
    share = values['gnss.gate_probability']
    return GnssSettings(
        topic=values['gnss_topic'], lever_arm=FLU_TO_FRD @ np.asarray(values['gnss.lever_arm'], dtype=float),
        lever_arm_sigma=values['gnss.lever_arm_sigma'],
        time_offset=values['gnss.time_offset'], lag=values['gnss.lag_per_acceleration'], sigma=values['gnss.sigma'],
        default_sigma=values['gnss.default_sigma'], max_delay=values['gnss.max_delay'],
        # root of the quantile of a chi-square distribution with two degrees of freedom
        gate=math.sqrt(-2.0 * math.log1p(-share)) if share < 1.0 else 0.0,
        outage_after=values['gnss.outage_after'], coloured=_coloured(values))


def _alignment(values: dict, is_level: bool) -> AlignmentSettings:
    return AlignmentSettings(values['alignment.heading'], values['alignment.yaw'], values['alignment.yaw_sigma'],
                             values['alignment.level'] and is_level, max(values['gyroscope.initial_sigma']))


def _vehicle(values: dict) -> VehicleSettings:
    return VehicleSettings(values['vehicle.zero_velocity'] * values['vehicle.zero_velocity_sigma'],
                           values['vehicle.non_holonomic'] * values['vehicle.non_holonomic_sigma'],
                           values['vehicle.still_acceleration'], values['vehicle.still_rate'])
