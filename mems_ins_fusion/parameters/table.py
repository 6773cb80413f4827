"""The table of all parameters of the package: name, default, unit, range, meaning.

The nodes declare their parameters from this table, the tools check their YAML against it, and `docs/parameters.md` is
generated from it. A YAML file may contain any of the parameters, whichever tool reads it: one file configures a
vehicle.
"""
from __future__ import annotations

import math

from ..effects.registry import EFFECTS
from ..filter.measurements.registry import AIDING, FROM_IMU, INPUTS, named_parameters
from ..hints import did_you_mean
from ..sensor_errors.models import MODELS as SENSOR_MODELS
from .parameter import Parameter, ParameterError


def _per_axis(name, default, unit, description, **limits):
    """A parameter with one value for all three axes or one for each of x, y, z (sensor axes)."""
    description += ' One value for all axes, or three: sensor axes x, y, z.'
    return Parameter(name, default, unit, description, lengths=(1, 3), **limits)


def _sensor(sensor, unit, noise_density, initial_sigma, random_walk, sigma, driving_noise):
    """The parameters that accelerometer and gyroscope share; numbers are those of a consumer-grade part."""
    return (
        _per_axis(f'{sensor}.noise_density', [noise_density], f'{unit}/sqrt(Hz)',
                  'White noise: velocity or angle random walk.', minimum=0.0, maximum=1e3),
        _per_axis(f'{sensor}.bias', [0.0], unit, 'Constant bias, subtracted from the measurement.',
                  minimum=-1e3, maximum=1e3),
        _per_axis(f'{sensor}.initial_sigma', [initial_sigma], unit,
                  'Turn-on bias (one sigma) where no standstill before the start showed it.', positive=True,
                  maximum=1e3),
        _per_axis(f'{sensor}.random_walk.q', [random_walk], f'{unit}/sqrt(s)',
                  'Driving noise of the random-walk model.', minimum=0.0, maximum=1e3),
        _per_axis(f'{sensor}.gauss_markov.sigma', [sigma], unit,
                  'Standard deviation of the Gauss-Markov model.', minimum=0.0, maximum=1e3),
        _per_axis(f'{sensor}.gauss_markov.tau', [300.0], 's',
                  'Correlation time of the Gauss-Markov model.', positive=True, maximum=1e9),
        Parameter(f'{sensor}.autoregressive.coefficients', [-1.7132, 0.71415], '-',
                  'a_1..a_p of the autoregressive model, signs as in Eq. 15 of the paper: '
                  'y(n) = -a_1 y(n-1) - ... + b_0 w(n). p values for all axes, or 3 p: those of x, then y, then z. '
                  'With 3 p values `autoregressive.order` gives p.', minimum=-1e6, maximum=1e6, lengths=range(1, 61)),
        Parameter(f'{sensor}.autoregressive.order', 0, '-',
                  'Order p of the autoregressive model; 0 takes the number of coefficients.', minimum=0, maximum=20),
        _per_axis(f'{sensor}.autoregressive.b0', [driving_noise], unit,
                  'Driving noise b_0 of the autoregressive model.', minimum=0.0, maximum=1e3),
        Parameter(f'{sensor}.autoregressive.interval', 1.0, 's',
                  'Sampling interval the autoregressive model was fitted at.', minimum=1e-4, maximum=1e5),
        _per_axis(f'{sensor}.scale', [0.0], '-',
                  'Scale factor error S of Eq. 9 and 10: measured = (1 + S) true.', minimum=-0.5, maximum=0.5),
    )


MODELS = tuple(SENSOR_MODELS)
#: what a place consists of, and the largest magnitude of each, deg, deg, m
PLACE = (('latitude', 90.0), ('longitude', 360.0), ('height', 1e5))

#: what the filter needs, whoever runs it
FILTER = (
    Parameter('imu_topic', '/imu/data', 'text', 'Topic of sensor_msgs/Imu.', positive=True),
    Parameter('gnss_topic', '/gps/fix', 'text', 'Topic of sensor_msgs/NavSatFix, or, where they are installed, '
              'gps_msgs/GPSFix, septentrio_gnss_driver/PVTGeodetic, ublox_msgs/NavPVT.'),
    Parameter('temperature_topic', '', 'text', 'Topic of sensor_msgs/Temperature of the IMU; empty: none.'),
    *(measurement.topic_parameter for measurement in AIDING),
    INPUTS,
    Parameter('mechanization', 'strapdown', 'text', 'planar: that of the paper, f_x, f_y and w_z on a level road. '
              'strapdown: three-dimensional, all six sensors.', choices=('planar', 'strapdown')),
    Parameter('sensor_error_model', 'gauss_markov', 'text', 'Model of the sensor errors.', choices=MODELS),
    Parameter('feedback', 'closed', 'text', 'closed: estimated errors are fed back to mechanization and sensors. '
              'open: they are only subtracted from the output.', choices=('closed', 'open')),
    Parameter('imu.mounting_rpy', [0.0, 0.0, 0.0], 'rad', 'Roll, pitch, yaw of the rotation from sensor axes to '
              'base_link (forward-left-up).', lengths=(3,), minimum=-2 * math.pi, maximum=2 * math.pi),
    Parameter('imu.mounting_sigma', 0.1, 'rad', 'Standard deviation of pitch and yaw of imu.mounting_rpy. With '
              'vehicle.non_holonomic both are estimated, with this initial standard deviation; 0: they are exact.',
              minimum=0.0, maximum=0.5),
    Parameter('imu.max_specific_force', 100.0, 'm/s^2', 'A sample with a larger component is not used but bridged.',
              positive=True, maximum=1e5),
    Parameter('imu.max_angular_rate', 20.0, 'rad/s', 'The same for the gyroscopes.', positive=True, maximum=1e4),
    Parameter('imu.adapt_noise', True, '-', 'Raise the white noise of accelerometers and gyroscopes to that of their '
              'samples, which is larger in a vehicle that vibrates than at rest (strapdown). Set it to false for an '
              'IMU with a low pass before its sampling; diagnose reports such an IMU.'),
    Parameter('imu.acceleration_unit', 'm/s^2', 'text', 'Unit of Imu.linear_acceleration as the driver delivers it; '
              'every other parameter stays in SI units.', choices=('m/s^2', 'g', 'mg')),
    Parameter('imu.rate_unit', 'rad/s', 'text', 'The same for Imu.angular_velocity.', choices=('rad/s', 'deg/s')),
    Parameter('imu.max_gap', 0.5, 's', 'A longer gap between samples is bridged with the mean of the samples '
              'before and after it, and the covariance is raised by the motion that is possible in the gap.',
              positive=True, maximum=60.0),
    Parameter('imu.restart_gap', 10.0, 's', 'After a longer gap, or stamps that jump back, the filter aligns anew.',
              positive=True, maximum=86400.0),
    Parameter('gnss.lever_arm', [0.0, 0.0, 0.0], 'm', 'From the IMU to the antenna, base_link '
              '(forward-left-up).', lengths=(3,), minimum=-50.0, maximum=50.0),
    Parameter('gnss.lever_arm_sigma', 0.0, 'm', 'Standard deviation of gnss.lever_arm, forward and left each. It is in '
              'the published covariance of the position, which is that of the IMU; 0: the arm is exact.', minimum=0.0,
              maximum=10.0),
    Parameter('gnss.time_offset', 0.0, 's', 'A fix stamped t describes the vehicle when the IMU\'s clock read '
              't - time_offset.', minimum=-60.0, maximum=60.0),
    Parameter('gnss.time_offset_sigma', 0.0, 's', 'Standard deviation of gnss.time_offset; the remaining offset is '
              'estimated. 0: gnss.time_offset is exact.', minimum=0.0, maximum=2.0),
    Parameter('gnss.time_offset_walk', 0.0, 's/sqrt(s)', 'Random walk of the remaining time offset, for a receiver '
              'whose latency drifts or steps; 0: it hardly changes.', minimum=0.0, maximum=1.0),
    Parameter('gnss.sigma', 0.0, 'm', 'Horizontal standard deviation of a fix; 0 takes the covariance in the '
              'message.', minimum=0.0, maximum=1000.0),
    Parameter('gnss.default_sigma', 3.0, 'm', 'Used where the message\'s covariance is unknown or zero.',
              positive=True, maximum=1000.0),
    Parameter('gnss.max_delay', 1.0, 's', 'A fix may arrive this much later than the IMU samples of its time, in '
              'addition to gnss.time_offset; fixes that arrive later are dropped.', minimum=0.0, maximum=10.0),
    Parameter('gnss.robust_sigma', 3.0, 'sigma', 'A fix whose normalized innovation is larger is weighted down to '
              'this value (Huber); 0 trusts every fix.', minimum=0.0, maximum=1e6),
    Parameter('gnss.gate_probability', 0.999999, '-', 'A fix is refused when its innovation is outside the region '
              'that contains this share of all innovations of a fault-free receiver (and larger than 5 m); 1: none is '
              'refused.', positive=True, maximum=1.0),
    Parameter('gnss.recovery_time', 30.0, 's', 'The filter starts anew from fixes that have been refused in a row for '
              'this long; sooner if a filter that starts anew from them predicts better than one that refuses them.',
              positive=True, maximum=86400.0),
    Parameter('gnss.adapt_sigma', True, '-', 'Use the scatter of the fixes as their sigma. Where it is smaller than '
              'the sigma they state, slow errors count, too, as far as the innovations show them (strapdown).'),
    Parameter('gnss.adapt_covariance', True, '-', 'Raise the published covariance where the innovations of the fixes '
              'are correlated and too large for it, and that of the position by the slow errors of the receiver; the '
              'estimate itself does not change.'),
    Parameter('gnss.outage_after', 2.5, 's', 'Without a fix for this long the node reports an outage.', positive=True,
              maximum=86400.0),
    Parameter('gnss.coloured_noise.sigma', 0.0, 'm', 'Standard deviation of a first-order Gauss-Markov position '
              'error of the receiver, north and east; 0: none.', minimum=0.0, maximum=1000.0),
    Parameter('gnss.coloured_noise.tau', 60.0, 's', 'Its correlation time.', positive=True, maximum=1e9),
    *(parameter for measurement in AIDING for parameter in measurement.parameters()),
    *FROM_IMU,
    # the three models describe the same sensor: q = sigma sqrt(2 / tau)
    *_sensor('accelerometer', 'm/s^2', 0.01, 0.2, 4.1e-3, 0.05, 0.001165),
    *_sensor('gyroscope', 'rad/s', 3e-4, 0.01, 8.2e-5, 1e-3, 2.33e-5),
    Parameter('gyroscope.scale_sigma', 0.005, '-', 'Standard deviation of the remaining scale factor error '
              '(strapdown): the heading becomes less certain by this share of a turn. Data sheets of cheap parts allow '
              '0.01 to 0.03. 0: gyroscope.scale is exact.', minimum=0.0, maximum=0.5),
    Parameter('alignment.heading', 'course', 'text', 'Where the first heading comes from: course (of the fixes, once '
              'the vehicle moves; of a slow one with two receivers the way from antenna to antenna, with a '
              'magnetometer the magnetic field), orientation (of the Imu message) or parameter.',
              choices=('course', 'orientation', 'parameter')),
    Parameter('alignment.yaw', 0.0, 'rad', 'With alignment.heading parameter: the heading, clockwise from north.',
              minimum=-2 * math.pi, maximum=2 * math.pi),
    Parameter('alignment.yaw_sigma', 0.1, 'rad', 'Its standard deviation, and that of Imu.orientation.',
              positive=True, maximum=3.2),
    Parameter('alignment.level', True, '-', 'Remove the constant tilt that the accelerometers show at standstill.'),
    Parameter('vehicle.zero_velocity', True, '-', 'Use standstills: velocity and turn rate are zero.'),
    Parameter('vehicle.zero_velocity_sigma', 0.02, 'm/s', 'Standard deviation of the velocity at standstill.',
              positive=True, maximum=100.0),
    Parameter('vehicle.still_acceleration', 0.3, 'm/s^2', 'Before the start, the accelerometers are at rest when the '
              'standard deviation of each axis is smaller.', positive=True, maximum=100.0),
    Parameter('vehicle.still_rate', 0.05, 'rad/s', 'The same for the gyroscopes.', positive=True, maximum=100.0),
    Parameter('vehicle.learn_drift', True, '-', 'Learn the process noise of the biases of accelerometers and '
              'gyroscopes, as a multiple of that in their sensor error model, and the noise of the accelerometers that '
              'the fixes show beyond it (strapdown; not AR).'),
    Parameter('vehicle.non_holonomic', True, '-', 'A land vehicle does not move sideways (nor, strapdown, up).'),
    Parameter('vehicle.non_holonomic_sigma', 0.3, 'm/s', 'Standard deviation of the sideways velocity.',
              positive=True, maximum=100.0),
    Parameter('vehicle.non_holonomic_vertical_sigma', 2.0, 'm/s', 'Standard deviation of the velocity along the '
              'vertical axis of the vehicle (strapdown): motion of the suspension.', positive=True, maximum=100.0),
    Parameter('vehicle.non_holonomic_angle_sigma', 0.0, 'rad', 'Standard deviation of the direction of motion in the '
              'axes of the vehicle; times the speed, it adds to the two sigmas above, as squares.', minimum=0.0,
              maximum=0.5),
    Parameter('vehicle.sideslip_sigma', 0.0, 'rad/(m/s^2)', 'Standard deviation of vehicle.sideslip_per_acceleration.',
              minimum=0.0, maximum=0.1),
    Parameter('vehicle.rear_axle', [0.0, 0.0, 0.0], 'm', 'From the IMU to the middle of the axle that does not steer, '
              'base_link (forward-left-up): there the vehicle does not move sideways.', lengths=(3,), minimum=-20.0,
              maximum=20.0),
    Parameter('vehicle.rear_axle_sigma', 1.0, 'm', 'Standard deviation of each component of vehicle.rear_axle, of the '
              'lateral and the vertical one at most 1 m, as vehicles are longer than wide and high. They are estimated '
              'with vehicle.non_holonomic, the lateral one with a speed or an odometry of wheels, the vertical one '
              'with strapdown; 0: it is exact.', minimum=0.0, maximum=10.0),
    Parameter('vehicle.tilt_sigma', 0.05, 'rad', 'Standard deviation of slope and body roll, which the planar '
              'mechanization does not estimate; strapdown does not use it.', minimum=0.0, maximum=0.3),
    Parameter('horizon.limit', 5.0, 'm', 'Limit of the trust horizon, which is the time and the distance without fixes '
              'for which the horizontal error stays below this with a probability of 95 %.', positive=True,
              maximum=1e6),
    Parameter('horizon.speed', 10.0, 'm/s', 'Speed to which a slower vehicle is assumed to accelerate within the trust '
              'horizon; 0: it keeps its speed.', minimum=0.0, maximum=150.0),
    Parameter('diagnosis.online', 'off', 'text', 'Diagnose while driving. report: what `diagnose` finds in the last '
              'minutes is tested on the data that follow, and reported with the parameters to set; nothing is changed. '
              'apply: what this test proves is set in the running filter, and reset when it is proven to do harm.',
              choices=('off', 'report', 'apply')),
    Parameter('diagnosis.window', 1200.0, 's', 'With diagnosis.online: length of the past that is kept for the '
              'diagnosis.', minimum=120.0, maximum=7200.0),
    Parameter('diagnosis.share', 0.1, '-', 'With diagnosis.online: largest share of a core that the diagnosis takes, '
              'live in a process of its own. Its result is used 60 s / diagnosis.share after its begin, in a replay '
              'as well.', positive=True, maximum=1.0),
    Parameter('datum', [], 'deg, deg, m', 'Latitude, longitude and height of the local frame\'s origin; empty: the '
              'median of the first three good fixes.', lengths=(0, 3), elements=PLACE),
)

#: parameters of the live node alone
FUSION = (
    Parameter('odometry_topic', '/odometry/fused', 'text', 'Topic of the nav_msgs/Odometry published.'),
    Parameter('fix_topic', '/fix/fused', 'text', 'Topic of the fused position as sensor_msgs/NavSatFix.'),
    Parameter('odometry_rate', 0.0, 'Hz', 'Rate of the odometry; 0: one for each IMU sample.',
              minimum=0.0, maximum=2000.0),
    Parameter('predict_to_now', False, '-', 'Publish at odometry_rate by the clock, with the state predicted to the '
              'present time; false: publish when a sample comes, with its stamp.'),
    Parameter('frames', 'single', 'text', 'single: the odometry is the best estimate, in frame_id, and jumps a little '
              'with each fix. map_odom (REP 105): the odometry in frame_id never jumps, and map_frame_id -> frame_id '
              'contains the corrections by fixes; the best estimate is on pose_topic.',
              choices=('single', 'map_odom')),
    Parameter('two_d', False, '-', 'Publish pose and twist of a vehicle in the plane: z, roll, pitch and their rates '
              'are zero, with small variances.'),
    Parameter('vehicle_axes', False, '-', 'Publish pose and twist in the axes of the vehicle, by the estimated '
              'mounting, instead of those that imu.mounting_rpy gives.'),
    Parameter('frame_id', 'odom', 'text', 'Frame of the odometry\'s pose: east-north-up at the datum.'),
    Parameter('child_frame_id', 'base_link', 'text', 'Frame of the twist: forward-left-up.'),
    Parameter('map_frame_id', 'map', 'text', 'With frames map_odom: frame of the best estimate, east-north-up at the '
              'datum.'),
    Parameter('pose_topic', '/pose/fused', 'text', 'With frames map_odom: topic of the best estimate in map_frame_id, '
              'geometry_msgs/PoseWithCovarianceStamped.'),
    Parameter('publish_tf', False, '-', 'Broadcast frame_id -> child_frame_id on /tf, and with frames map_odom '
              'map_frame_id -> frame_id (needs tf2_msgs).'),
    Parameter('mounting_from_tf', False, '-', 'Take imu.mounting_rpy from tf: the rotation from the frame of the Imu '
              'messages to child_frame_id (needs tf2_ros).'),
    Parameter('arms_from_tf', False, '-', 'Take gnss.lever_arm and NAME.lever_arm of the further inputs from tf: from '
              'the frame of the Imu messages to that of each topic\'s first message, axes of child_frame_id (needs '
              'tf2_ros).'),
    Parameter('initial_pose_topic', '/initialpose', 'text', 'Topic of a start pose, '
              'geometry_msgs/PoseWithCovarianceStamped as RViz sends it; empty: none.'),
    Parameter('start_pose', [], 'deg, deg, m, rad', 'Latitude, longitude, height and heading (clockwise from north) of '
              'the vehicle at rest when the node starts; empty: found from the fixes.', lengths=(0, 4),
              elements=PLACE),
    Parameter('start_pose_sigma', [5.0, 0.1], 'm, rad', 'Standard deviation of the start pose: position, heading.',
              lengths=(2,), positive=True),
    Parameter('state_file', '', 'text', 'File in which position, heading and sensor errors are kept for the next '
              'start; empty: none.'),
    Parameter('state_file_max_age', 86400.0, 's', 'An older state file is not used.', positive=True),
    Parameter('state_file_max_distance', 20.0, 'm', 'A state file whose position is further from the first fix is not '
              'used.', positive=True),
)

#: parameters of replay_node and the tools
REPLAY = (
    Parameter('bag', [], 'text', 'Recordings to replay: rosbag2 folders, .mcap, .db3 or ROS 1 .bag files.'),
    Parameter('output_dir', '', 'text', 'Folder for the results.'),
    Parameter('overwrite', False, '-', 'Replace an existing result.'),
    Parameter('models', ['random_walk', 'gauss_markov', 'autoregressive'], 'text', 'Sensor error models to compare.',
              choices=MODELS),
    Parameter('update_intervals', [1.0, 3.0, 6.0], 's', 'Fixes are thinned out to these intervals; 0 uses each.',
              minimum=0.0, maximum=86400.0, lengths=range(0, 51)),
    Parameter('outage_durations', [10.0, 30.0, 60.0], 's', 'Fixes are withheld for this long.', minimum=0.1,
              maximum=86400.0, lengths=range(0, 51)),
    Parameter('outage_spacing', 30.0, 's', 'Time between the begins of two outages of one duration.', minimum=0.1,
              maximum=1e6),
    Parameter('smoothing', False, '-', 'Also smooth: each state is estimated from all measurements of the recording, '
              'before and after it.'),
    Parameter('fixes_until', 0.0, 's', 'Dead reckoning: fixes later than this after the recording\'s first IMU sample '
              'are not used, and errors count from then on; 0: all are used.', minimum=0.0, maximum=1e9),
    Parameter('start', 0.0, 's', 'Skip this much of the recording.', minimum=0.0, maximum=1e9),
    Parameter('stop', 0.0, 's', 'Stop this long after the recording\'s start; 0: at its end.', minimum=0.0,
              maximum=1e9),
    Parameter('fix_noise', 0.0, 'm', 'White noise added to north and east of each fix used, to turn a survey receiver '
              'into an ordinary one.', minimum=0.0, maximum=1e4),
    Parameter('seed', 0, '-', 'Seed of fix_noise.', minimum=0, maximum=2**53),
    Parameter('reference_topic', '', 'text', 'Topic of the reference: NavSatFix, Odometry or PoseStamped; empty: the '
              'withheld fixes are the truth.'),
    Parameter('reference_clock', 'auto', 'text', 'Clock of the stamps of the reference, for a diagnosis: imu; gnss, '
              'that of the receiver (gnss.time_offset applies to the reference as well); own, a clock of its own; '
              'auto: gnss where reference and fixes agree at equal stamps, else imu unless the time offset that is '
              'found contradicts it.',
              choices=('auto', 'imu', 'gnss', 'own')),
    Parameter('reference_lever_arm', [], 'm', 'From the IMU to the point that the reference describes, base_link '
              '(forward-left-up); empty: the antenna, gnss.lever_arm.', lengths=(0, 3), minimum=-50.0, maximum=50.0),
    Parameter('reference_file', '', 'text', 'Reference trajectory as a file: CSV, TUM, NMEA or RTKLIB .pos.'),
    Parameter('verbose', False, '-', 'Print everything that is in report.html, not only the answer.'),
    Parameter('fitted_to', [], 'text', 'Hashes of the recordings that the values were fitted to: written by configure '
              'and diagnose, so that replay and compare can tell a proof from a fit. The filter does not read it.'),
    Parameter('memory_limit', 2.0, 'GB', 'A tool refuses a recording that would take more memory than this; a replay '
              'with pages takes 0.9 GB for an hour at 100 Hz, 2.2 GB for eight.', minimum=0.5, maximum=1e6),
    Parameter('write_bag', False, '-', 'Also write a rosbag2 with one Odometry topic per model.'),
    Parameter('publish', False, '-', 'Publish the replayed odometry on topics, with /clock.'),
    Parameter('rate', 1.0, '-', 'With publish: speed of the replay; 2 is twice as fast as recorded.', minimum=1e-3,
              maximum=1e6),
)

FILTER += tuple(setting for effect in EFFECTS.values() for setting in effect.settings)

ALL = {p.name: p for p in (*FILTER, *FUSION, *REPLAY)}


def defaults() -> dict:
    """All parameters with their defaults."""
    return {name: list(p.default) if isinstance(p.default, list) else p.default for name, p in ALL.items()}


def check(values: dict) -> dict:
    """The defaults, updated with `values`. Raises ParameterError for an unknown name or a value that does not fit."""
    known, checked = parameters_of(values), defaults()
    checked |= {name: parameter.default for name, parameter in known.items() if name not in ALL}
    for name, value in values.items():
        if name not in known:
            raise ParameterError(unknown(name))
        checked[name] = known[name].check(value)
    return checked


def parameters_of(values: dict) -> dict[str, Parameter]:
    """ALL, and the parameters of the named inputs in the unchecked `values`."""
    return {**ALL, **named_parameters(values, ALL)}


def unknown(name: str) -> str:
    """Message for a user who wrote the unknown parameter `name`."""
    return f"unknown parameter '{name}'{did_you_mean(name, ALL)}"
