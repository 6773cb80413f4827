"""Where antenna and IMU are, from the static transforms of a recording: taken where the drive agrees, else said."""
from __future__ import annotations

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore
from scipy.spatial.transform import Rotation

from mems_ins_fusion.configuration.configure import configure
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.filter.measurements.registry import aiding
from mems_ins_fusion.parameters import table
from mems_ins_fusion.recordings.bags import Bag
from mems_ins_fusion.recordings.messages import IMU, NAV_SAT_FIX
from mems_ins_fusion.recordings.transforms import sensor_poses
from mems_ins_fusion.recordings.writing import write_recording
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, SimulatedAiding, simulate_recording

MOUNTING, ARM = (0.02, -0.03, 1.5), [0.9, -0.2, 1.1]
#: where the IMU is in base_link; a plate stands between both, turned
IMU_AT = np.array([0.3, 0.1, 0.5])
STORE = get_typestore(Stores.ROS2_JAZZY)


def with_transforms(bag, path, links, frames=None):
    """A copy of `bag` (mcap) with links {child: (parent, Rotation, place)} on /tf_static, each in a message of its own,
    as each broadcaster sends it. frames: by topic, its frame and another one, as long, that it has in the copy."""
    types = STORE.types
    with Bag(bag) as source, Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as target:
        connections = {topic: target.add_connection(topic, kind, typestore=STORE)
                       for topic, kind in source.topics.items()}
        static = target.add_connection('/tf_static', 'tf2_msgs/msg/TFMessage', typestore=STORE)
        blocks = list(source.read(source.topics))
        begin = min(times[0] for _, times, _, _ in blocks if times)
        for child, (parent, rotation, place) in links.items():
            vector, quaternion = (types[f'geometry_msgs/msg/{name}'] for name in ('Vector3', 'Quaternion'))
            one = types['geometry_msgs/msg/TransformStamped'](
                types['std_msgs/msg/Header'](types['builtin_interfaces/msg/Time'](0, 0), parent), child,
                types['geometry_msgs/msg/Transform'](vector(*map(float, place)), quaternion(*rotation.as_quat())))
            target.write(static, begin, STORE.serialize_cdr(types['tf2_msgs/msg/TFMessage']([one]),
                                                            'tf2_msgs/msg/TFMessage'))
        for topic, times, messages, _ in blocks:
            for time, message in zip(times, messages):
                old, new = (frames or {}).get(topic, (b'', b''))
                target.write(connections[topic], time, bytes(message).replace(old, new))
    return path


@pytest.fixture(scope='module')
def plain(tmp_path_factory):
    """A drive of five minutes with an antenna at ARM and the IMU turned by MOUNTING, without transforms."""
    drive = simulate_drive(300.0, 3, 50.0, standstill=20.0, hills=True)
    sensors = SensorErrors.from_parameters(table.defaults(), 'gauss_markov')
    arm = EFFECTS['gnss_lever_arm'], dict(zip('xyz', ARM))
    made = simulate_recording(drive, sensors, GnssNoise(0.02, 2.0), [arm], MOUNTING, 3)
    path = tmp_path_factory.mktemp('bag') / 'plain'
    write_recording(made.recording, path)
    return path


def links_of(arm, rpy=MOUNTING):
    plate = Rotation.from_euler('ZYX', [0.7, 0.1, 0.0])
    mounting = Rotation.from_euler('ZYX', rpy[::-1])
    return {'plate': ('base_link', plate, [0.1, 0.2, 0.3]),
            'imu': ('plate', plate.inv() * mounting, plate.inv().apply(IMU_AT - [0.1, 0.2, 0.3])),
            'gnss': ('base_link', Rotation.identity(), IMU_AT + arm), 'base_link': ('chassis', plate, [5.0, 0.0, 0.0])}


def test_places_go_through_all_frames_between_a_sensor_and_the_vehicle(plain, tmp_path):
    with Bag(with_transforms(plain, tmp_path / 'bag', links_of(ARM))) as bag:
        found = sensor_poses(bag, {'/imu/data': IMU, '/gps/fix': NAV_SAT_FIX})
    place, rotation = found['/imu/data']
    assert place == pytest.approx(IMU_AT) and found['/gps/fix'][0] == pytest.approx(IMU_AT + ARM)
    # sensor to vehicle, as imu.mounting_rpy
    assert Rotation.from_matrix(rotation).as_euler('ZYX')[::-1] == pytest.approx(MOUNTING)


@pytest.mark.parametrize('wrong', ['in a circle', 'no way', 'NaN', 'none'])
def test_what_does_not_lead_to_the_vehicle_is_no_place(plain, wrong, tmp_path):
    same, here = Rotation.identity(), [0, 0, 0]
    links = {'in a circle': {'imu': ('plate', same, here), 'plate': ('imu', same, here)},
             'no way': {'imu': ('elsewhere', same, here)},
             'NaN': {'imu': ('base_link', same, [np.nan, 0, 0])}, 'none': {}}[wrong]
    with Bag(with_transforms(plain, tmp_path / 'bag', links)) as bag:
        assert not sensor_poses(bag, {'/imu/data': IMU})


def test_configure_takes_the_arm_of_transforms_that_the_drive_agrees_with(plain, tmp_path):
    found = configure([with_transforms(plain, tmp_path / 'bag', links_of(ARM))])
    why = {setting.name: ' '.join(setting.why) for setting in found.settings}
    assert found.values['gnss.lever_arm'] == ARM and 'from /tf_static; the drive shows' in why['gnss.lever_arm']
    # the mounting that the drive shows stays
    assert '/tf_static says roll, pitch, yaw 1.1, -1.7, 85.9 deg' in why['imu.mounting_rpy']
    assert not any('/tf_static' in line for line in found.wrong)


def test_configure_says_where_transforms_contradict_the_drive_and_takes_what_it_saw(plain, tmp_path):
    links = links_of(np.subtract(ARM, [3.0, 0.0, 0.0]), (0.0, 0.0, 0.0))
    found, without = configure([with_transforms(plain, tmp_path / 'bag', links)]), configure([plain])
    assert found.values == {**without.values, 'fitted_to': found.values['fitted_to']}
    said = '\n'.join(found.wrong)
    assert '/tf_static has the IMU turned by 86 deg from what the drive shows' in said
    assert '/tf_static has the antenna -2.10 m forward of the IMU' in said
    assert '/tf_static' not in '\n'.join(without.wrong)


def test_what_a_drive_without_turns_does_not_show_comes_from_the_transforms(tmp_path):
    # given a vehicle that stands for a minute
    made = simulate_recording(simulate_drive(60.0, 3, 50.0, standstill=59.0),
                              SensorErrors.from_parameters(table.defaults(), 'gauss_markov'), GnssNoise(0.5, 2.0),
                              mounting_rpy=MOUNTING, seed=3)
    write_recording(made.recording, tmp_path / 'plain')
    found = configure([with_transforms(tmp_path / 'plain', tmp_path / 'bag', links_of(ARM))])
    assert found.values['gnss.lever_arm'] == ARM
    assert found.values['imu.mounting_rpy'] == pytest.approx(MOUNTING, abs=1e-4)
    assert table.check(found.values)


#: antennas 1.6 m apart, the left wheel and an antenna that tells its velocity; what tf says of them
REAR, LEFT, SIDE = [-0.7, 0.1, 1.1], [0.0, 0.75, -0.4], [0.9, 0.5, 1.1]
INPUTS = {'gnss.lever_arm': ARM, 'inputs': ['rear', 'left', 'side'], 'rear.type': 'fix', 'rear.topic': '/rear/fix',
          'rear.lever_arm': REAR, 'left.type': 'speed', 'left.topic': '/wheels/left', 'left.lever_arm': LEFT,
          'side.type': 'velocity', 'side.topic': '/side/gps_velocity', 'side.lever_arm': SIDE}


def robot(path, seconds=300.0, sigma=0.1):
    """A drive with INPUTS, each with a frame of its own, without transforms."""
    values = table.check(INPUTS)
    named = [one for one in aiding(values) if not one.is_plain]
    drive = simulate_drive(seconds, 3, 50.0, standstill=20.0, hills=True, axle_to_imu=(1.0, 0.0, 0.0))
    made = simulate_recording(drive, SensorErrors.from_parameters(table.defaults(), 'gauss_markov'),
                              GnssNoise(sigma, 2.0), [(EFFECTS['gnss_lever_arm'], dict(zip('xyz', ARM)))], MOUNTING, 3,
                              aiding=SimulatedAiding(fix_rate=2.0, fix_sigma=sigma, velocity_rate=5.0),
                              named=named)
    topics = {one.topic: values[one.topic] for one in named}
    write_recording(made.recording, path, inputs=named, **topics)
    return path


FRAMES = {'/rear/fix': (b'gnss\0', b'rear\0'), '/side/gps_velocity': (b'gnss\0', b'side\0'),
          '/wheels/left': (b'base_link\0', b'left_link\0')}


def links_of_robot(**moved):
    same = Rotation.identity()
    return links_of(ARM) | {name: ('base_link', same, IMU_AT + moved.get(name, arm))
                            for name, arm in (('rear', REAR), ('side', SIDE), ('left_link', LEFT))}


def set_up(path, bag, **moved):
    found = configure([with_transforms(bag, path, links_of_robot(**moved), FRAMES)])
    assert table.check(found.values)
    return found, {setting.name: ' '.join(setting.why) for setting in found.settings}


def test_configure_takes_arms_of_further_inputs_that_the_drive_agrees_with(tmp_path):
    bag = robot(tmp_path / 'plain')
    found, why = set_up(tmp_path / 'bag', bag)
    # then each input has the arm of its own frame, and a velocity of another antenna has a name
    assert found.values['inputs'] == ['rear_fix', 'side_gps_velocity', 'wheels_left']
    for name, arm in (('rear_fix', REAR), ('side_gps_velocity', SIDE), ('wheels_left', LEFT)):
        assert found.values[f'{name}.lever_arm'] == pytest.approx(arm) and '/tf_static' in why[f'{name}.lever_arm']
    assert 'the drive shows' in why['rear_fix.lever_arm'] and 'm left' in why['wheels_left.lever_arm']
    assert 'does not show it' in why['side_gps_velocity.lever_arm']
    assert found.values['rear_fix.lever_arm_sigma'] == 0.05
    assert not any('/tf_static' in line for line in found.wrong)
    # given a wheel's frame on the other side, and a rear antenna elsewhere
    found, why = set_up(tmp_path / 'wrong', bag, rear=[-2.0, 0.1, 1.1], left_link=[0.0, -0.75, -0.4])
    # then both contradictions are said, and what the drive shows is taken
    said = '\n'.join(found.wrong)
    assert '/tf_static has /rear/fix -2.90 m forward of the antenna of gnss_topic, the drive shows -1.' in said
    assert '/tf_static has /wheels/left -0.75 m left of the IMU, the drive shows 0.' in said
    assert found.values['rear_fix.lever_arm'][0] == pytest.approx(REAR[0], abs=0.15)
    assert found.values['wheels_left.lever_arm'][1] == pytest.approx(LEFT[1], abs=0.3)
    # and what nothing contradicts stays
    assert found.values['gnss.lever_arm'] == ARM and found.values['side_gps_velocity.lever_arm'] == pytest.approx(SIDE)


def test_a_receiver_whose_antenna_only_the_transforms_place_is_used(tmp_path):
    # given fixes that scatter by 4 m in a short drive
    bag = robot(tmp_path / 'plain', seconds=70.0, sigma=4.0)
    without = configure([bag])
    with_them, why = set_up(tmp_path / 'bag', bag)
    # then without transforms its place is not known, with them it is
    assert '/rear/fix is not used: too little motion, or too noisy' in ' '.join(
        line for setting in without.settings if setting.name == 'inputs' for line in setting.why)
    assert with_them.values['rear_fix.lever_arm'] == pytest.approx(REAR)
