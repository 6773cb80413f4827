"""Results of `configure`: the params file with evidence as comments, and a page with the data behind it."""
from __future__ import annotations

import math
import shlex
import textwrap
from pathlib import PurePath

import numpy as np

from ..configuration.configure import Configuration
from ..evaluation.verdict import unsettled
from ..parameters.params_file import yaml_value
from ..recordings.remarks import ERROR
from . import html
from .answer import GOOD, WARNING, Answer, Step, cure, shorten
from .html import bullets, figure, folded, paragraph, preformatted, section, table
from .settings import settings_table
from .verdict import unsettled_text

_WIDTH = 116  # largest number of characters in a line of comment
_POINTS = 4000  # approximate number of points in a figure


def doubts(result: Configuration) -> list[str]:
    """Why the file is not ready for driving: what is wrong with the recordings, what they do not show, and values that
    may be wrong. In this order, as the console shows only the first, and the others often follow from it."""
    return [*result.wrong, *result.missing,
            *(unsettled_text(left) for left in unsettled(result.left) if math.isfinite(left.sigma))]


def configuration_yaml(result: Configuration) -> str:
    """The params file."""
    names = ', '.join(drive.name for drive in result.drives)
    lines = [*textwrap.wrap(f'Written by configure from {names}.', _WIDTH, initial_indent='# ', subsequent_indent='# '),
             '# Each value with what it stands on; +- and sigma: one standard deviation.',
             *(line for text in doubts(result) for line in textwrap.wrap(
                 f'! {text}', _WIDTH, initial_indent='# ', subsequent_indent='#   ')),
             '/**:', '  ros__parameters:']
    for setting in result.settings:
        for why in setting.why:
            lines += textwrap.wrap(why, _WIDTH, initial_indent='    # ', subsequent_indent='    #   ')
        lines.append(f'    {setting.name}: {yaml_value(setting.value)}')
    return '\n'.join(lines) + '\n'


def result_lines(result: Configuration) -> list[str]:
    """The results as lines."""
    values = result.values
    lines = [f'IMU {values["imu_topic"]} ({values["imu.acceleration_unit"]}, {values["imu.rate_unit"]}), '
             f'fixes {values["gnss_topic"] or "none"}; {values["mechanization"]}']
    found = result.mounting
    if found is not None:
        angles, sigma = np.degrees(found.rpy), np.degrees(found.sigma)
        yaw = f'{angles[2]:.1f} +- {sigma[2]:.1f}' if found.yaw_known else 'not shown'
        lines.append(f'mounting: roll {angles[0]:.1f} +- {sigma[0]:.1f} deg, pitch {angles[1]:.1f} +- {sigma[1]:.1f} '
                     f'deg, yaw {yaw}{" deg" if found.yaw_known else ""}')
        if found.offset is not None and found.offset.shown:
            lines.append(f'fixes against the IMU\'s clock: {found.lag:.3f} +- {found.lag_sigma:.3f} s'
                         f'{_not_set(values)}')
    return lines


def summary_line(result: Configuration) -> str:
    """The same in one line for a console: units, angles, time offset. Only the yaw is shown with its sigma, which
    differs most between drives."""
    said, found = f'{result.values["imu.acceleration_unit"]}, {result.values["imu.rate_unit"]}', result.mounting
    if found is not None:
        roll, pitch, yaw = (f'{angle:.1f}' if abs(angle) < 100.0 else f'{angle:.0f}' for angle in np.degrees(found.rpy))
        said += f', roll {roll}, pitch {pitch}, yaw ' + (
            f'{yaw} +- {math.degrees(found.sigma[2]):.1f} deg' if found.yaw_known else 'not shown')
        if found.offset is not None and found.offset.shown:
            said += f'; fixes {abs(found.lag):.3f} +- {found.lag_sigma:.3f} s {"late" if found.lag > 0 else "early"}'
            said += _not_set(result.values)
    return shorten(f'found: {said}')


def _not_set(values: dict) -> str:
    """That a time offset of less than two sigma is not in the file."""
    return '' if values['gnss.time_offset'] else ' (not set)'


def answer(result: Configuration, bags: list[str], output: str) -> Answer:
    """Whether the file is ready for driving, what is wrong or unknown, and the next command. bags, output: paths of the
    recordings and of the file, for the commands."""
    found, wrong = result.mounting, doubts(result)
    path, name = shlex.quote(output), PurePath(output).name
    steps = [Step('Find what is missing in it:', f'python -m mems_ins_fusion diagnose --bag {shlex.join(bags)} '
                  f'--params-file {path} --output diagnosis'),
             Step('Look at how good it is on this recording:', f'python -m mems_ins_fusion replay_node --ros-args '
                  f'--params-file {path} -p bag:={shlex.quote(bags[0])} -p output_dir:=replay'),
             Step('Drive with it:', f'python -m mems_ins_fusion fusion_node --ros-args --params-file {path}')]
    broken = [remark for drive in result.drives for remark in drive.remarks if remark.severity == ERROR]
    if found is None or not found.yaw_known:
        headline = f'{name} is not complete: the recording does not show how the IMU is mounted.'
        steps = [cure(broken, bags) if broken else Step(
            'Record a drive with a standstill, right-angled turns and braking, and run configure again; or set '
            'imu.mounting_rpy by hand.')]
    elif wrong:
        headline = f'{name} can be used; see below what is not right or not known.'
    else:
        headline = f'{name} is ready to drive with.'
    return Answer(WARNING if wrong or found is None or not found.yaw_known else GOOD, headline, wrong, [], steps)


def configuration_page(result: Configuration, yaml_text: str, answered: Answer) -> str:
    """The page with the results and their data."""
    summary = f'{", ".join(drive.name for drive in result.drives)}: {"; ".join(result_lines(result))}'
    return html.page('Parameters found in the recording', [
        section('Is the file ready?', answered.html(), *_figure(result),
                settings_table({s.name: s.value for s in result.settings}, evidence=_evidence(result))),
        answered.evidence(), *_mounting(result), _sensors(result),
        folded('The file', preformatted(yaml_text)), _explanation()], summary.replace('+-', '\N{PLUS-MINUS SIGN}'))


def _evidence(result) -> dict[str, str]:
    return {s.name: '; '.join(s.why).replace('+-', '\N{PLUS-MINUS SIGN}') for s in result.settings}


def _mounting(result):
    found = result.mounting
    if found is None:
        return [folded('Mounting', paragraph('The recording does not show how the IMU is mounted.'))]
    rows = [[way.source, 'roll, pitch', _list(way.angle), _list(way.sigma)] for way in found.level]
    rows += [[way.source, 'yaw', _list(way.angle), _list(way.sigma)] for way in found.heading]
    parts = [paragraph('Each line is one way to find an angle: its difference from the result of all ways together.'),
             table(['found by', 'angle', 'difference, deg', 'sigma, deg'], rows)]
    return [folded('Mounting', *parts)]


def _figure(result):
    """The figure of the answer."""
    found = result.mounting
    if found is None or found.spans is None:
        return []
    return [figure(_force_figure(found), 'Specific force in the axes of the mounting that was found, against the '
                   'acceleration by fixes and gyroscopes; each dot is some seconds of the drive. If the mounting is '
                   'right, the dots lie along the diagonal at top left and bottom right, and along the level line in '
                   'the others. They scatter because roads slope, along and across.')]


def _list(angles) -> str:
    return ', '.join(f'{math.degrees(angle):.1f}' for angle in angles)


def _force_figure(found):
    drive = found.spans
    some = slice(None, None, max(len(drive.time) // _POINTS, 1))
    moving = np.abs(drive.speed[some]) > 0.5
    force = (drive.force[some] - found.bias) @ found.rotation.T
    drawing = html.empty_figure(9, 7)
    panels = drawing.subplots(2, 2, sharex='col', sharey='row')
    causes = (('change of speed, m/s^2', drive.acceleration[some]),
              ('speed times turn rate (left), m/s^2', -drive.centripetal[some]))
    for row, (name, measured) in enumerate((('forward', force[:, 0]), ('left', force[:, 1]))):
        for column, (label, cause) in enumerate(causes):
            axes = panels[row, column]
            axes.plot(cause[moving], measured[moving], '.', markersize=2.5, color='#1b6ca8', alpha=0.5)
            reach = max(float(np.percentile(np.abs(cause[moving]), 99)), 0.2) if moving.any() else 1.0
            ends = np.array([-reach, reach])
            axes.plot(ends, ends if row == column else 0 * ends, color='0.3', linewidth=1)
            axes.set_xlim(-1.3 * reach, 1.3 * reach)
            axes.grid(color='0.92')
            if row:
                axes.set_xlabel(label)
            if not column:
                axes.set_ylabel(f'specific force {name}, m/s^2')
    for row in panels:
        reach = float(np.percentile(np.abs(force[moving, :2]), 99.5)) if moving.any() else 1.0
        row[0].set_ylim(-1.3 * reach, 1.3 * reach)
    return drawing


def _sensors(result):
    rows = [[candidate.topic, kind, candidate.messages, candidate.rate, 'chosen' if i == 0 else candidate.describe()]
            for kind, candidates in (('IMU', result.topics.imu), ('receiver', result.topics.gnss))
            for i, candidate in enumerate(candidates)]
    drives = [[drive.name, drive.seconds, float(drive.still.mean() * drive.seconds),
               drive.mounting.driven if drive.mounting else None,
               math.degrees(drive.mounting.turned) if drive.mounting else None] for drive in result.drives]
    return folded('Recordings', table(['topic', 'as', 'messages', 'rate, Hz', 'use'], rows),
                   table(['recording', 'length, s', 'at rest, s', 'driving, s', 'turned, deg'], drives))


def _explanation():
    return folded('How to read this', bullets([
        'The yaw comes from the direction in which the specific force changes with the speed, in turns and on grades; '
        'forwards is where the vehicle goes most of the time.',
        'Roll and pitch come from gravity, averaged over the drive, and from the axis about which the vehicle turns. A '
        'bias of the accelerometers tilts gravity, but not that axis.',
        'Sigmas are from leaving out one stretch of the drive after the other. The method: docs/configure.md.']))
