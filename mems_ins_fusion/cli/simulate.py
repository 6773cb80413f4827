"""`simulate`: write a recording of a simulated drive, with the truth."""
from __future__ import annotations

import argparse
import textwrap
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.effects.aiding_lag import AidingLag
from mems_ins_fusion.effects.aiding_time_offset import AidingTimeOffset
from mems_ins_fusion.effects.base import Effect
from mems_ins_fusion.effects.registry import EFFECTS, effects_of
from mems_ins_fusion.errors import InputError
from mems_ins_fusion.hints import did_you_mean
from mems_ins_fusion.parameters import params_file, table
from mems_ins_fusion.reports.answer import WIDTH

#: what options may be: lowest, highest, unit
_RANGES = {'duration': (0.1, 1e7, ' s'), 'rate': (1.0, 1e4, ' Hz'), 'gnss_rate': (1e-4, 1e3, ' Hz'),
           'input_rate': (0.01, 1e3, ' Hz'), 'gnss_sigma': (0.0, 1e3, ' m'), 'gnss_latency': (0.0, 60.0, ' s'),
           'reference_rate': (1e-3, 1e4, ' Hz'), 'standstill': (0.0, 1e7, ' s'), 'seed': (0, 2**63 - 1, '')}
#: GB at the start, bytes for each sample
_MEMORY = 0.3, 450.0

DESCRIPTION = """\
Write a rosbag2 of a simulated land vehicle: a standstill, then straights, bends, right-angle turns and stops at
2-20 m/s. Topics: /imu/data and /gps/fix (or imu_topic and gnss_topic of the params file), and the truth as
/reference/fix and /reference/odometry: position and velocity of the IMU (base_link, not the antenna), attitude of the
body. The odometry's origin is the first fix. The effect `temperature` adds /imu/temperature, --aiding /wheel/speed
(of the rear axle), /gps/velocity and /gps/heading, or where the parameters say. Each input that has a topic in the
params file is simulated, those with a name too, further receivers with the rate and the sigma of the first.

--drive realistic is a drive to test filters with, with everything that the options below offer: a car on its springs on
a road with grade and bank, an IMU that shakes and whose mounting is off by up to 5 deg (each seed another), turn-on
biases, standstills with the engine on and off, long smooth cruises, reversing. Each option changes one thing in it, or
adds it to the level drive that is the default.

The sensors' errors and what the params file declares (imu.mounting_rpy, gnss.lever_arm, gnss.time_offset, scale,
bias, gnss.coloured_noise) are simulated as it says. Effects given with --effect come on top, declared nowhere."""


def main(argv: list[str] | None = None) -> int:
    """Run the tool with `argv` (default: the command line); its exit status."""
    return run(_parser(), simulate, argv)


def simulate(options: argparse.Namespace) -> str:
    """Simulate and write what `options` ask for; a line that says what was written. InputError for bad options."""
    from mems_ins_fusion.filter.measurements.registry import further_inputs
    from mems_ins_fusion.recordings.reading import Memory
    from mems_ins_fusion.results import check_free
    from mems_ins_fusion.simulation.simulation import GnssNoise, SensorErrors, simulate_recording

    for name, (low, high, unit) in _RANGES.items():
        value = getattr(options, name)
        if value is not None and not low <= value <= high:
            raise InputError(f"--{name.replace('_', '-')} must be from {low:g} to {high:g}{unit}, got {value!s:.20}")
    scene = _scene(options)
    values = table.check({**scene.imu, **params_file.load_files(options.params_file)})
    effects = parse_effects(options.effect, {effect.name: effect for effect in effects_of(values)})
    model = options.model or values['sensor_error_model']
    sigma = 0.02 if options.rtk else values['gnss.sigma'] or 1.5
    sigma = sigma if options.gnss_sigma is None else options.gnss_sigma
    gnss = GnssNoise(sigma, options.gnss_rate, [parse_outage(text) for text in options.outage], options.gnss_latency,
                     coloured_sigma=options.gnss_coloured, outliers=options.gnss_outliers,
                     smoothing=options.gnss_smoothing, dropouts=options.gnss_dropouts)
    Memory(values['memory_limit'], *_MEMORY).check(f'--duration {options.duration:g} at --rate {options.rate:g}',
                                                   round(options.duration * max(options.rate, options.gnss_rate,
                                                                                options.input_rate)))
    check_free(options.output, options.overwrite, 'metadata.yaml')
    drive = scene.drive(options.duration, options.seed, options.rate, hills=options.hills,
                        standstill=options.duration if options.static else options.standstill)
    if not len(gnss.times(drive.time[-1])):
        raise InputError('the outages leave no fix in the recording')
    distortions = {**scene.distortions(options.seed), 'aiding': _aiding(scene, options, values, sigma),
                   'named': [m for m in further_inputs(values) if not m.is_plain]}
    effects = [*distortions.pop('effects'), *effects]
    simulation = simulate_recording(drive, SensorErrors.from_parameters(values, model), gnss,
                                    [*_declared(values), *effects], values['imu.mounting_rpy'], options.seed,
                                    **distortions)
    _write(simulation, options, values)
    recording = simulation.recording
    distance = np.linalg.norm(np.diff(drive.position, axis=0), axis=1).sum()
    added = '; '.join(f'{effect.name} {" ".join(f"{k}={v:.3g}" for k, v in given.items())}'
                      for effect, given in effects)
    said = (f'{options.output}: {drive.time[-1]:g} s, {distance / 1000:.2f} km, {len(recording.imu)} IMU samples '
            f'({model} errors), {len(recording.gnss)} fixes of {sigma:g} m', f'effects: {added or "none"}')
    return '\n'.join(line for one in said for line in textwrap.wrap(one, WIDTH, subsequent_indent='    '))


def _scene(options):
    """The scene of --drive with what other options change in it."""
    from mems_ins_fusion.simulation.scene import SCENES

    scene = SCENES[options.drive]
    given = {name: getattr(options, name) for name in ('grade', 'bank', 'parked_on_slope', 'manoeuvres', 'body',
                                                       'vibration', 'rotating_earth') if getattr(options, name)}
    if options.axle_to_imu:
        given['axle_to_imu'] = tuple(options.axle_to_imu)
    for name in ('mounting_error', 'unevenness'):
        if getattr(options, name) is not None:
            given[name] = np.radians(getattr(options, name))
    return replace(scene, **given)


def _aiding(scene, options, values, gnss_sigma):
    """Rates and errors of the further sensors: those of the scene, all with --aiding, those with a topic in the params
    file. Further receivers are like the first."""
    from mems_ins_fusion.filter.measurements.registry import AIDING
    from mems_ins_fusion.simulation.simulation import SimulatedAiding

    rates = {f'{m.name}_rate': options.gnss_rate if m.from_satellites else options.input_rate
             for m in AIDING if m.simulated_with and (options.aiding or values[m.topic])}
    return SimulatedAiding(**{**(scene.aiding or {}), **rates, 'fix_rate': options.gnss_rate, 'fix_sigma': gnss_sigma})


def _write(simulation, options, values):
    from mems_ins_fusion.filter.measurements.registry import further_inputs
    from mems_ins_fusion.navigation.frames import FLU_TO_FRD
    from mems_ins_fusion.recordings.writing import odometry_from_reference, write_recording

    recording, drive = simulation.recording, simulation.drive
    if not len(recording.gnss):
        raise InputError('the outages leave no fix in the recording')
    thinned = slice(None, None, max(round(options.rate / options.reference_rate), 1))
    reference = recording.reference.select(thinned)
    datum = recording.gnss.latitude[0], recording.gnss.longitude[0], recording.gnss.height[0]
    odometry = odometry_from_reference(reference, datum, drive.roll[thinned], drive.pitch[thinned])
    odometry = replace(odometry, angular_rate=drive.angular_rate[thinned] @ FLU_TO_FRD)
    write_recording(replace(recording, reference=reference), options.output, options.storage,
                    overwrite=options.overwrite, odometry={'/reference/odometry': odometry},
                    imu_topic=values['imu_topic'], gnss_topic=values['gnss_topic'],
                    inputs=further_inputs(values), **{name: values[name] for name in (
                        'temperature_topic', *(m.topic for m in further_inputs(values)))
                       if values[name]})


def parse_effects(texts: list[str], known: Mapping[str, Effect] = EFFECTS) -> list[tuple]:
    """The effects that NAME=VALUE and NAME.PARAM=VALUE texts ask for, each with all its parameters.

    NAME=VALUE sets the effect's principal parameter. known: the effects there are. ValueError names what is not known.
    """
    values: dict[str, dict[str, float]] = {}
    for text in texts:
        key, equals, number = text.partition('=')
        name, _, parameter = key.partition('.')
        if not equals:
            raise InputError(f"--effect must be NAME=VALUE or NAME.PARAM=VALUE, got '{text}'")
        if name not in known:
            hint = did_you_mean(name, known) or '; --help lists them'
            raise InputError(f"no effect is named '{name}'{hint}")
        values.setdefault(name, {})[parameter or known[name].principal] = _number('--effect', text, number)
    return [(known[name], known[name].complete(given)) for name, given in values.items()]


def parse_outage(text: str) -> tuple[float, float]:
    """START:STOP as two numbers, s."""
    start, colon, stop = text.partition(':')
    if not colon:
        raise InputError(f"--outage must be START:STOP in seconds, got '{text}'")
    return _number('--outage', text, start), _number('--outage', text, stop)


def _number(option, text, number):
    try:
        value = float(number)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{option} {text}: '{number}' is not a number")
    return value


def _declared(values):
    """The effects that the parameters declare and a filter with the same parameters corrects."""
    arm = dict(zip('xyz', values['gnss.lever_arm']))
    coloured = {name: values[f'gnss.coloured_noise.{name}'] for name in ('sigma', 'tau')}
    return [(EFFECTS['gnss_time_offset'], {'time_offset': values['gnss.time_offset']}),
            (EFFECTS['gnss_lever_arm'], arm), (EFFECTS['gnss_coloured_noise'], coloured),
            *((effect, {'time_offset': values[f'{effect.of}.time_offset'] - values.get(f'{effect.of}.lag', 0.0)})
              for effect in effects_of(values) if isinstance(effect, AidingTimeOffset)),
            *((effect, {'tau': values[f'{effect.of}.lag']}) for effect in effects_of(values)
              if isinstance(effect, AidingLag) and effect.known)]


def _parser():
    parser = Parser('simulate', DESCRIPTION, _effects_help())
    add = parser.add_argument
    add('--output', required=True, metavar='BAG', help='folder of the rosbag2 to write')
    parser.add_overwrite()
    add('--storage', choices=('mcap', 'sqlite3'), default='mcap')
    add('--duration', type=float, default=600.0, metavar='S', help='seconds (default %(default)g)')
    add('--seed', type=int, default=0, help='the same seed gives the same recording (default %(default)s)')
    add('--rate', type=float, default=100.0, metavar='HZ', help='of the IMU (default %(default)g)')
    add('--gnss-rate', type=float, default=1.0, metavar='HZ', help='of the fixes (default %(default)g)')
    add('--input-rate', type=float, default=10.0, metavar='HZ', help='of wheels, odometry, heading, pressure and '
        'magnetic field, of the inputs without a name (default %(default)g)')
    add('--gnss-sigma', type=float, metavar='M', help='white noise, north and east (default: gnss.sigma of the params '
        'file, else 1.5)')
    add('--gnss-latency', type=float, default=0.0, metavar='S', help='from the stamp of a fix to its arrival')
    add('--reference-rate', type=float, default=10.0, metavar='HZ', help='of the truth (default %(default)g)')
    add('--model', choices=table.MODELS, help='of the sensor errors (default: sensor_error_model of the params '
        'file, else gauss_markov)')
    parser.add_params_file('the parameters of the sensors')
    add('--drive', choices=('flat', 'realistic'), default='flat', help='(default %(default)s)')
    add('--grade', type=float, metavar='G', help='largest grade of a random road (0.03 is 3 %%)')
    add('--bank', type=float, metavar='B', help='largest bank of a random road')
    add('--parked-on-slope', action='store_true', help='the drive begins where grade and bank are largest')
    add('--manoeuvres', choices=('city', 'mixed', 'traffic', 'slow'), help='mixed: also long cruises, red lights, '
        'reversing; traffic: dense traffic that creeps and stops; slow: a robot at 0.4 m/s that turns on the spot, too')
    add('--body', action='store_true', help='pitch and roll on the suspension, and sideslip, of a car')
    add('--unevenness', type=float, metavar='DEG', help='with --body: pitch and roll from the road at 10 m/s, RMS')
    add('--vibration', type=float, metavar='A', help='vibration by the road, m/s^2 RMS at 10 m/s; by the engine, half '
        'of it')
    add('--mounting-error', type=float, metavar='DEG', help='largest error of roll, pitch and yaw of the mounting')
    add('--axle-to-imu', type=float, nargs=3, metavar=('X', 'Y', 'Z'), help='from the rear axle to the IMU, '
        'forward-left-up, m')
    add('--aiding', action='store_true', help='also wheel speed, velocity and heading')
    add('--rtk', action='store_true', help='fixes of 2 cm')
    add('--gnss-coloured', type=float, default=0.0, metavar='M', help='standard deviation of an error of the fixes '
        'with a correlation time of a minute')
    add('--gnss-outliers', type=float, default=0.0, metavar='SHARE', help='share of fixes that are tens of metres off')
    add('--gnss-smoothing', type=float, default=0.0, metavar='S', help="time constant of the receiver's filter")
    add('--gnss-dropouts', type=float, default=0.0, metavar='N', help='number of drop-outs of 3 to 40 s in an hour')
    add('--hills', action='store_true', help='a road with grades of up to 6 %% instead of a level one')
    add('--rotating-earth', action='store_true', help='earth rate and Coriolis acceleration, which planar neglects')
    add('--standstill', type=float, default=25.0, metavar='S', help='at the start (default %(default)g)')
    add('--static', action='store_true', help='the vehicle never moves: a recording for characterize')
    add('--outage', action='append', default=[], metavar='START:STOP', help='seconds without fixes; repeatable')
    add('--effect', action='extend', nargs='+', default=[], metavar='NAME[.PARAM]=VALUE',
        help='one or several, repeatable; SI units')
    return parser


def _effects_help():
    lines = ['effects and their parameters (* is meant by NAME=VALUE):']
    for effect in EFFECTS.values():
        names = [f'{p.name}{"*" if p.name == effect.principal else ""} [{p.unit}]' for p in effect.parameters]
        lines.append(f'  {effect.name:<23} {", ".join(names)}')
    return '\n'.join(lines)
