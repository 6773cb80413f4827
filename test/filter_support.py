"""What the tests of the filter share: configurations, a filter's memory with a given state, dense matrices."""
from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from mems_ins_fusion.filter import advance, kernel
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import (
    INPUT_SIZE,
    NAV,
    PLANAR,
    Event,
    Kind,
    Nav,
    covariance,
    newest_row,
    row_width,
    set_covariance,
    views,
)
from mems_ins_fusion.filter.start.initial import initialize
from mems_ins_fusion.filter.start.start import Start
from mems_ins_fusion.navigation.strapdown import from_euler
from mems_ins_fusion.parameters import table

#: the paper's filter: planar, nothing known of the vehicle, every fix believed as it claims; what a test asks for
#: beyond that, it says
PAPER = {'mechanization': 'planar', 'vehicle.zero_velocity': False, 'vehicle.non_holonomic': False,
         'vehicle.tilt_sigma': 0.0, 'gnss.gate_probability': 1.0, 'gnss.adapt_sigma': False,
         'gnss.adapt_covariance': False, 'gnss.robust_sigma': 0.0, 'vehicle.learn_drift': False,
         'imu.adapt_noise': False,
         'vehicle.non_holonomic_sigma': 0.2, 'vehicle.non_holonomic_vertical_sigma': 0.2, 'imu.mounting_sigma': 0.0,
         'vehicle.rear_axle_sigma': 0.0}
MODELS = ('random_walk', 'gauss_markov', 'autoregressive')
#: models with states of their own size, as parameters; AR(1) to AR(3) step at every sample of 0.01 s
MODEL_VALUES = {
    'RW': {'sensor_error_model': 'random_walk'},
    'GM': {'sensor_error_model': 'gauss_markov', 'accelerometer.gauss_markov.tau': [7.0],
           'gyroscope.gauss_markov.tau': [11.0]},
    **{f'AR({len(a)})': {'sensor_error_model': 'autoregressive', 'accelerometer.autoregressive.coefficients': a,
                         'gyroscope.autoregressive.coefficients': [0.9 * a[0], *a[1:]],
                         'accelerometer.autoregressive.interval': 0.01, 'gyroscope.autoregressive.interval': 0.01}
       for a in ([-0.9], [-1.2, 0.4], [-1.1, 0.3, -0.05])}}
LATITUDE, LONGITUDE, HEIGHT = 0.84, 0.2, 480.0


def configure(values=(), **more) -> FilterConfig:
    """The defaults with `values` (full names) laid over them; keywords for names without a dot."""
    return FilterConfig.from_parameters(table.check({**PAPER, **dict(values), **more}))


def started(config: FilterConfig, *, velocity=(12.0, -5.0, 0.3), attitude=(0.02, -0.03, 0.7), x=None, p=None,
            time=0.0) -> np.ndarray:
    """A memory with that first state: velocity m/s in n, roll, pitch, yaw, errors x (n,), covariance p (n, n)."""
    memory = config.memory()
    initialize(memory, config, Start(time, LATITUDE, LONGITUDE, HEIGHT, np.asarray(velocity[:2], float), attitude[2],
                                     np.eye(5), None))
    rows = views(memory)[2]
    row = rows[0]
    if config.mechanization != PLANAR:
        row[Nav.V_D] = velocity[2]
        row[Nav.Q_W:Nav.Q_Z + 1] = from_euler(*attitude)
    if x is not None:
        row[NAV:NAV + len(x)] = x
    if p is not None:
        set_covariance(row, config.layout, p)
    return memory


def newest(memory: np.ndarray) -> np.ndarray:
    """The newest state, a copy of its row."""
    return newest_row(memory).copy()


def state_and_covariance(config: FilterConfig, memory: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Error state (n,) and covariance (n, n) of the newest state."""
    row = newest(memory)
    return row[NAV:NAV + config.layout.n].copy(), covariance(row, config.layout)


def fix_event(time, latitude=LATITUDE, longitude=LONGITUDE, height=HEIGHT, r=((1.0, 0.0), (0.0, 1.0)), down=4.0):
    """A fix as the kernel takes it; r: (2, 2) north-east m^2, down: m^2."""
    event = np.zeros(Event.SIZE)
    event[[Event.TIME, Event.KIND]] = time, Kind.POSITION
    event[[Event.LATITUDE, Event.LONGITUDE, Event.HEIGHT]] = latitude, longitude, height
    event[[Event.R_NN, Event.R_NE, Event.R_EE, Event.R_DD]] = r[0][0], r[0][1], r[1][1], down
    return event


def input_event(config: FilterConfig, time, kind) -> np.ndarray:
    """An event of the unnamed input of this kind, which has a topic, without a value."""
    event = np.zeros(Event.SIZE)
    event[[Event.TIME, Event.KIND]] = time, kind
    event[Event.INPUT:Event.INPUT_END] = config.of_input(kind)
    return event


def statistics_at(config: FilterConfig, kind: int) -> int:
    """Column of a row from which on the filter has its statistics (`memory.INPUT`) of the unnamed input."""
    return row_width(config.layout) - INPUT_SIZE * int(config.of_input(kind)[0])


def random_covariance(n: int, rng: np.random.Generator, scale=None) -> np.ndarray:
    """A positive definite matrix (n, n) that is far from diagonal."""
    root = rng.standard_normal((n, n))
    scale = np.ones(n) if scale is None else np.asarray(scale)
    return np.outer(scale, scale) * (root @ root.T + 0.1 * np.eye(n))  # symmetric to the last bit


def second_order_variance(config: FilterConfig, p, attitude: Rotation, mounting=()) -> np.ndarray:
    """Covariance of what no derivative holds of the velocity across the vehicle: lateral and (strapdown) vertical.

    It is the product of two errors, of the forward speed and of the angle, those of the attitude and of the mounting
    (names of the states) together.
    """
    layout, forward = config.layout, attitude.as_matrix()[:, 0]
    planar = config.mechanization == PLANAR
    velocity = slice(2, 4) if planar else slice(3, 6)
    speed = forward[:velocity.stop - velocity.start] @ p[velocity, velocity] @ forward[:velocity.stop - velocity.start]
    angles = []
    for k, axis in enumerate((2,) if planar else (2, 1)):
        across = attitude.as_matrix()[:, axis]
        angle = p[4, 4] if planar else across @ p[6:9, 6:9] @ across
        state = layout.index(mounting[k]) if mounting else -1
        angles.append(angle + (p[state, state] if state >= 0 else 0.0))
    return speed * np.diag(angles)


def central_difference(function, size: int, step) -> np.ndarray:
    """Jacobian of function((size,)) -> (k,) at zero; step: (size,) or one."""
    columns = []
    for i, h in enumerate(np.broadcast_to(step, size)):
        e = np.zeros(size)
        e[i] = h
        columns.append((np.asarray(function(e)) - np.asarray(function(-e))) / (2 * h))
    return np.column_stack(columns)


def velocity_of(config: FilterConfig, memory: np.ndarray) -> np.ndarray:
    """North, east, down velocity (3,) of the newest state, estimated errors not yet taken out."""
    return newest(memory)[[Nav.V_N, Nav.V_E, Nav.V_D]]


def attitude_of(config: FilterConfig, memory: np.ndarray) -> Rotation:
    """Rotation from b to n of the newest state, estimated errors not yet taken out."""
    row = newest(memory)
    if config.mechanization == PLANAR:
        return Rotation.from_euler('z', row[Nav.YAW])
    return Rotation.from_quat(row[[Nav.Q_X, Nav.Q_Y, Nav.Q_Z, Nav.Q_W]])


def take_sample(memory: np.ndarray, time, f_x, f_y, f_z, w_x, w_y, w_z) -> None:
    """One IMU sample in sensor axes through the kernel."""
    _run(memory, np.array([[time, f_x, f_y, f_z, w_x, w_y, w_z]], dtype=float), np.zeros((0, Event.SIZE)))


def take_event(memory: np.ndarray, event: np.ndarray) -> int:
    """One measurement through the kernel; its answer."""
    return _run(memory, np.zeros((0, 7)), event.reshape(1, -1).copy())


def take_all(memory: np.ndarray, samples: np.ndarray, events: np.ndarray, columns,
             late=0.0) -> tuple[np.ndarray, np.ndarray]:
    """Samples (k, 7) and measurements (e, Event.SIZE) by time through the kernel, each in time for the sample after it,
    or `late` (one or e), s after that.

    The columns of the state after each sample (k, c), and the events (e, Event.SIZE) with what came of them.
    """
    events, states = events.copy(), np.empty((len(samples), len(columns)))
    events[:, Event.ID] = np.arange(len(events))
    log, answers = events.copy(), np.zeros(len(events), dtype=np.int64)
    arrival = np.searchsorted(samples[:, 0], events[:, Event.TIME] + late)
    order = np.argsort(arrival, kind='stable')
    kernel.run(memory, samples, events[order], arrival[order], answers, np.asarray(columns, dtype=np.uint64),
               np.arange(len(samples)), states, log)
    assert np.all(answers == advance.TAKEN)
    return states, log


def _run(memory, samples, events) -> int:
    none, answers = np.zeros(0, dtype=np.int64), np.zeros(len(events), dtype=np.int64)
    kernel.run(memory, samples, events, np.zeros(len(events), dtype=np.int64), answers, np.zeros(0, dtype=np.uint64),
               none, np.zeros((0, 0)), np.zeros((0, Event.SIZE)))
    return int(answers[0]) if len(answers) else 0
