"""A toy of each kind is added to a copy of the package, in no file but those that docs/how_to_add.md lists, and works.

The copy runs in a process of its own without the compiler: it would compile anew what hundreds of samples do not need.
What a toy touches is what the filter needs of it; that the lists are complete for those that are there, with their
messages, nodes and reports, is looked at in test_how_to_add.py.
"""
from __future__ import annotations

import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PAGE = (ROOT / 'docs' / 'how_to_add.md').read_text(encoding='utf-8')

BEGIN = """
import json
import numpy as np
from mems_ins_fusion.filter.config import FilterConfig
from mems_ins_fusion.filter.memory import Event
from mems_ins_fusion.filter.runs.replay import run
from mems_ins_fusion.filter.start.start import Start
from mems_ins_fusion.navigation.earth import gravity
from mems_ins_fusion.parameters import table
from mems_ins_fusion.samples import Aiding, Fixes, ImuSamples

RATE, SECOND, LATITUDE, HEIGHT = 25, 10**9, 0.8, 100.0
PAPER = {'vehicle.zero_velocity': False, 'vehicle.non_holonomic': False, 'imu.mounting_sigma': 0.0,
         'vehicle.rear_axle_sigma': 0.0, 'vehicle.tilt_sigma': 0.0}

def at_rest(seconds, force=(0.0, 0.0, 0.0), rate=(0.0, 0.0, 0.0)):
    stamp = np.arange(1, seconds * RATE + 1) * (SECOND // RATE)
    up = np.array([0.0, 0.0, gravity(LATITUDE, HEIGHT)])
    shape = (len(stamp), 3)
    return ImuSamples(stamp, stamp, np.broadcast_to(up + force, shape).copy(), np.broadcast_to(rate, shape).copy())

def fixes_at(seconds, sigma):
    stamp = np.asarray(seconds) * SECOND + SECOND // 100
    n = len(stamp)
    return Fixes(stamp, stamp, np.full(n, LATITUDE), np.zeros(n), np.full(n, HEIGHT),
                 np.tile(np.eye(3) * sigma**2, (n, 1, 1)), np.zeros(n, np.int8), np.full(n, 2, np.uint8))

def replay(values, imu, fixes, aiding=Aiding(), velocity=(0.0, 0.0)):
    start = Start(0.0, LATITUDE, 0.0, HEIGHT, np.array(velocity), 0.0, np.diag([1.0, 1.0, 0.01, 0.01, 1e-4]), None)
    return run(FilterConfig.from_parameters(table.check({**PAPER, **values})), imu, fixes, aiding, start)
"""


@pytest.fixture()
def copy(tmp_path):
    """What adds a toy to a copy of the package: add(title, edits, script); what the script has printed."""
    shutil.copytree(ROOT / 'mems_ins_fusion', tmp_path / 'mems_ins_fusion', ignore=shutil.ignore_patterns('__pycache__'))

    def add(title, edits, script):
        listed = tuple(re.findall(r'`(mems_ins_fusion/[\w/.]*)`', PAGE.split(f'## {title}\n')[1].split('\n## ')[0]))
        for name, changes in edits.items():
            file = tmp_path / 'mems_ins_fusion' / name
            assert f'mems_ins_fusion/{name}'.startswith(listed), f'{name} is not in the list of the page'
            if isinstance(changes, str):
                assert not file.exists()
                file.write_text(changes, encoding='utf-8')
                continue
            text = file.read_text(encoding='utf-8')
            for old, new in changes:
                assert text.count(old) == 1, f'{name}: {old!r} stands there {text.count(old)} times'
                text = text.replace(old, new)
            file.write_text(text, encoding='utf-8')
        environment = {**os.environ, 'PYTHONPATH': str(tmp_path), 'NUMBA_DISABLE_JIT': '1'}
        done = subprocess.run([sys.executable, '-c', BEGIN + script], cwd=tmp_path, env=environment, text=True,
                              capture_output=True, timeout=300)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return add


def after(line, added):
    """`added` below a line that is there once."""
    return line, line + added


EFFECT = """from __future__ import annotations

import numpy as np

from mems_ins_fusion.effects.base import Effect, EffectParameter
from mems_ins_fusion.parameters.parameter import Parameter


class GyroscopeSquare(Effect):
    name = 'gyroscope_square'
    signature = 'across-track innovations after bends, of the same sign to both sides'
    in_words, to_check = 'the gyroscope is not linear', 'its data sheet'
    largest, larger_is = {'k': 0.2}, 'a scale'
    parameters = (EffectParameter('k', 's/rad', 0.02, adds_to=('gyroscope.square',)),)
    settings = (Parameter('gyroscope.square', 0.0, 's/rad', 'What w_z squared adds to w_z.', minimum=-1.0, maximum=1.0),)

    def distort_imu(self, drive, specific_force, angular_rate, values, rng):
        angular_rate = angular_rate.copy()
        angular_rate[:, 2] += values['k'] * angular_rate[:, 2]**2
        return specific_force, angular_rate

    def corrector(self, values, rotation):
        k = values['gyroscope.square']
        if k == 0.0:
            return None

        def correct(stamp, force, rate, celsius):
            body = rate @ rotation.T
            body[:, 2] = (np.sqrt(1.0 + 4.0 * k * body[:, 2]) - 1.0) / (2.0 * k)
            return force, body @ rotation

        return correct
"""


def test_an_effect(copy):
    # given: a gyroscope that reads k w^2 too much, and a drive simulated with k = 0.2
    edits = {
        'effects/gyroscope_square.py': EFFECT,
        'effects/registry.py': [
            after('from mems_ins_fusion.effects.gyroscope_scale import GyroscopeScale\n',
                  'from mems_ins_fusion.effects.gyroscope_square import GyroscopeSquare\n'),
            ('(\n    GnssTimeOffset(),', '(\n    GyroscopeSquare(), GnssTimeOffset(),')]}
    # when: filters that know of different k are asked how well their innovations fit
    fits = copy('An effect', edits, """
from mems_ins_fusion.effects.registry import EFFECTS
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import GnssNoise, simulate_recording
effect = EFFECTS['gyroscope_square']
drive = simulate_drive(70.0, 3, RATE, standstill=10.0)
recording = simulate_recording(drive, gnss=GnssNoise(sigma=0.1), effects=[(effect, {'k': 0.2})]).recording
fits = {}
for k in (0.0, 0.1, 0.2, 0.3):
    values = table.check({**PAPER, 'mechanization': 'planar', 'gnss.sigma': 0.1, 'gnss.adapt_sigma': False,
                          'gyroscope.gauss_markov.sigma': [1e-5], 'gyroscope.initial_sigma': [1e-5]})
    config = FilterConfig.from_parameters(effect.adjusted(values, {'k': k}))
    event = run(config, recording.imu, recording.gnss).measured.event
    fits[k] = float(np.square(event[:, [Event.Z_N, Event.Z_E]]).sum())
print(json.dumps(fits))
""")
    # then: that with the true one does best

    assert min(fits, key=fits.get) == '0.2'
    assert fits['0.0'] > fits['0.1'] > fits['0.2'] < fits['0.3']


def test_a_sensor_error_model(copy):
    # given: a bias that never changes, as a model of its own
    edits = {
        'sensor_errors/models.py': [('#: by the name of the parameter `sensor_error_model`\n', '''@dataclass(frozen=True)
class RandomConstant(Model):
    """A bias that is not known and does not change. initial_sigma: its standard deviation."""

    initial_sigma: float
    holds_turn_on = True

    @classmethod
    def from_parameters(cls, parameters, sensor):
        return [cls(s) for s in per_axis(parameters, f'{sensor}.initial_sigma')]

    def transition(self, dt: float) -> np.ndarray:
        return np.ones((1, 1))

    def process_noise(self, dt: float) -> np.ndarray:
        return np.zeros((1, 1))

    def initial_covariance(self) -> np.ndarray:
        return np.full((1, 1), self.initial_sigma**2)


#: by the name of the parameter `sensor_error_model`
'''), ("= {'random_walk': RandomWalk,", "= {'random_constant': RandomConstant, 'random_walk': RandomWalk,")]}
    # when: a sensor with a bias of 0.02 m/s^2 stands for 20 s, and then none is seen for 4 s
    forward, sigma = copy('A sensor error model', edits, """
imu = at_rest(24, force=(0.02, 0.0, 0.0))
values = {'mechanization': 'planar', 'sensor_error_model': 'random_constant', 'accelerometer.initial_sigma': [0.1],
          'accelerometer.noise_density': [1e-4], 'gnss.sigma': 0.1, 'gnss.adapt_sigma': False}
result = replay(values, imu, fixes_at(range(20), 0.1))
at = result.config.layout.n_navigation
print(json.dumps([result.sensor_errors[-1, 0], [result.sigma[20 * RATE + 5, at], result.sigma[-1, at]]]))
""")
    # then: it is found, and as well known after 4 s without fixes as before
    assert forward == pytest.approx(0.02, abs=3 * sigma[0]) and sigma[0] < 0.01
    assert sigma[1] == pytest.approx(sigma[0], rel=1e-9)


ALTITUDE = """from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mems_ins_fusion.compiled import njit

from ...navigation import strapdown
from ...samples import _Samples
from ..memory import Event, Nav
from .base import Measurement
from .events import empty, stated_or

KIND = 20


@njit(_nrt=False)
def observe(mem, r, at, h, n, c, sample):
    mem[at + Event.Z_N] = mem[r + Nav.HEIGHT] - mem[at + Event.VALUE]
    mem[h + strapdown.State.R_D] = -1.0
    return 1


@dataclass(frozen=True)
class Altitudes(_Samples):
    stamp: np.ndarray
    received: np.ndarray
    altitude: np.ndarray
    variance: np.ndarray


class Altitude(Measurement):
    observe = staticmethod(observe)
    kind, name, samples, unit, default_sigma = KIND, 'altitude', Altitudes, 'm', 1.0
    topic_text = 'Topic of the altitude, toy_msgs/Altitude'
    messages = {'toy_msgs/msg/Altitude': ('altitude', 'variance')}
    layouts = {'toy_msgs/msg/Altitude': (('altitude', '<f8', 1), ('variance', '<f8', 1))}
    written_to = '/altitude'
    simulated_with = {'altitude_rate': 0.0, 'altitude_sigma': 0.1}

    def events(self, settings, altitudes):
        n = len(altitudes)
        r = empty(KIND, n)
        r[:, Event.VALUE] = altitudes.altitude
        r[:, Event.R_NN] = stated_or(altitudes.variance, settings, 0.01)
        return r, {}, {}

    def read(self, fields, message):
        return Altitudes(fields['stamp'], fields['received'], fields['altitude'], fields['variance'])

    def written(self, altitudes):
        return {'altitude': altitudes.altitude, 'variance': altitudes.variance}

    def simulated(self, drive, errors, effects, rng, instants):
        time, stamp = instants(errors['altitude_rate'], 0.0)
        height = np.interp(time, drive.time, drive.height) + errors['altitude_sigma'] * rng.standard_normal(len(time))
        return Altitudes(stamp, stamp.copy(), height, np.full(len(time), errors['altitude_sigma'] ** 2))
"""


def test_a_measurement(copy):
    # given: a barometer, whose altitude is a measurement of the strapdown filter's height: its file, and its line in the
    # registry
    edits = {
        'filter/measurements/altitude.py': ALTITUDE,
        'filter/measurements/registry.py': [
            after('from __future__ import annotations\n\n', 'from .altitude import Altitude\n'),
            ('Heading(), Pressure())', 'Heading(), Pressure(), Altitude())')]}
    # when: it says 107 m where fixes of 10 m say 100 m; and fixes of 10 m alone
    found = copy('A measurement', edits, """
from dataclasses import replace
from mems_ins_fusion.evaluation.comparison import aiding_of, time_span
from mems_ins_fusion.filter.measurements.altitude import Altitudes
from mems_ins_fusion.filter.runs.live import FusionFilter
from mems_ins_fusion.recordings import messages
from mems_ins_fusion.recordings.checker import check_recording
from mems_ins_fusion.recordings.several import shifted_recording
from mems_ins_fusion.simulation.drive import simulate_drive
from mems_ins_fusion.simulation.simulation import SimulatedAiding, simulate_recording
imu, fixes = at_rest(8), fixes_at(range(8), 10.0)
stamp = np.arange(1, 8) * SECOND + SECOND // 2
altitudes = Altitudes(stamp, stamp, np.full(len(stamp), HEIGHT + 7.0), np.full(len(stamp), 0.01))
found = {}
for name, aiding in (('alone', Aiding()), ('with it', Aiding(altitude=altitudes))):
    topics = {f'{one}_topic': '/altitude' for one in aiding}
    result = replay({'gnss.adapt_sigma': False, **topics, 'altitude.time_offset_sigma': 0.0}, imu, fixes, aiding)
    found[name] = [result.height[-1], result.sigma[-1, 2]]
# and it is on its way everywhere else
values = table.check({'altitude_topic': '/altitude', 'altitude.sigma': 0.2})
drive = simulate_drive(20.0, 3, RATE, standstill=10.0)
recording = simulate_recording(drive, aiding=SimulatedAiding(altitude_rate=5.0)).recording
found['simulated'] = len(recording.streams()['altitude'])
found['cut'] = len(aiding_of(shifted_recording(time_span(recording, 0.0, 10.0), SECOND))['altitude'])
found['checked'] = sorted({finding.topic for finding in check_recording(recording)})
kind = 'toy_msgs/msg/Altitude'
from mems_ins_fusion.filter.measurements.registry import MEASUREMENTS
written = {**messages.stamp_fields(altitudes.stamp), **MEASUREMENTS[20].written(altitudes)}
array, _ = messages.decode([bytes(m) for m in messages.encode(kind, written, {'header.frame_id': 'b'})], kind)
read = MEASUREMENTS[20].read({'stamp': messages.stamps(array), 'received': stamp, 'altitude': array['altitude'],
                             'variance': array['variance']}, kind)
found['read'] = [bool(np.array_equal(getattr(read, n), getattr(altitudes, n))) for n in ('stamp', 'altitude')]
live = FusionFilter(FilterConfig.from_parameters(values))
live.add_imu(SECOND, 0.0, 0.0, 9.8, 0.0, 0.0, 0.0)
live.add('altitude', SECOND, float('nan'), 1.0)
found['live'] = live.health()
print(json.dumps(found))
""")
    # then: the height is the barometer's, and known as well as that says
    (alone, alone_sigma), (height, sigma) = found['alone'], found['with it']
    assert height == pytest.approx(107.0, abs=0.2) and sigma < 0.2
    assert alone == pytest.approx(100.0, abs=0.5) and alone_sigma > 1.0
    assert found['simulated'] == 101 and found['cut'] == 51 and found['read'] == [True, True]
    assert found['live']['state'] == 'waiting'


NOT_TURNING = '''"""As strapdown, on an earth that does not turn: for gyroscopes that are far from seeing it."""
from __future__ import annotations

from mems_ins_fusion.compiled import njit

from .strapdown import CHANNELS, STATES, State, error_step, mechanize  # noqa: F401


@njit
def frame_rates(latitude, v_n, v_e, north_radius, east_radius):
    return 0.0, 0.0, v_e / east_radius, -v_n / north_radius, 0.0
'''


def test_a_mechanization(copy):
    # given: a strapdown mechanization that knows nothing of the earth's rotation
    edits = {
        'navigation/not_turning.py': NOT_TURNING,
        'filter/memory.py': [
            ('import planar, strapdown', 'import not_turning, planar, strapdown'),
            ('PLANAR, STRAPDOWN = 0, 1', 'PLANAR, STRAPDOWN, NOT_TURNING = 0, 1, 2'),
            ('STRAPDOWN: strapdown}', 'STRAPDOWN: strapdown, NOT_TURNING: not_turning}'),
            ("'strapdown': STRAPDOWN}", "'strapdown': STRAPDOWN, 'not_turning': NOT_TURNING}")],
        'filter/prediction.py': [
            ('import planar, strapdown', 'import not_turning, planar, strapdown'),
            ('    PLANAR,\n    WHITE,', '    NOT_TURNING,\n    PLANAR,\n    WHITE,'),
            ('    attitude, c, f_level, moved, velocity = strapdown.mechanize(',
             '    if mem[Head.MECHANIZATION] == NOT_TURNING:\n        rates = not_turning.frame_rates(latitude, '
             'mem[src + Nav.V_N], mem[src + Nav.V_E], 1.0 / mem[src + Nav.NORTH_SCALE], 1e7)\n'
             '    attitude, c, f_level, moved, velocity = strapdown.mechanize(')],
        'parameters/table.py': [("choices=('planar', 'strapdown'))", "choices=('planar', 'strapdown', 'not_turning'))")]}
    # when: an IMU stands for 10 s whose gyroscopes read zero, so that it turns against the earth with the stars
    turned = copy('A mechanization', edits, """
imu, found = at_rest(10), {}
for name in ('strapdown', 'not_turning'):
    result = replay({'mechanization': name}, imu, fixes_at([], 1.0))
    found[name] = [float(angle[-1]) for angle in (result.roll, result.pitch, result.yaw)]
print(json.dumps(found))
""")
    # then: the one sees the earth's 15 degrees an hour, the other none
    assert math.hypot(*turned['strapdown']) == pytest.approx(7.292e-5 * 10.0, rel=0.02)
    assert math.hypot(*turned['not_turning']) < 1e-6
