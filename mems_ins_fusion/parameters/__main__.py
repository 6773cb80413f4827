"""Writes the documents generated from the table of parameters: `docs/parameters.md`, and `config/fusion.yaml` with
--yaml."""
from __future__ import annotations

import math
import sys
import textwrap

from .parameter import Parameter
from .params_file import yaml_value
from .table import FILTER, FUSION, REPLAY

#: what a user has to set, before the tables
_WHICH = """\
## Which ones matter

Few. The filter estimates or learns most of what the others describe, and begins with their defaults.

1. *What nothing else tells:* topics, units, `imu.mounting_rpy`, `gnss.lever_arm` (a tape measure).
   [`configure`](configure.md) finds them in a recording, the arm less well than a tape.
2. *What the vehicle has or is:* `gnss.time_offset` (`configure` finds it), `speed_topic` and other inputs,
   `vehicle.non_holonomic: false` for what moves sideways (`config/boat.yaml`), `vehicle.zero_velocity: false` for what
   moves as quietly as it stands, `alignment.heading` for what is too slow for a course (`config/robot.yaml`).
3. *Noise* is worth less: on three measured drives white noise of the IMU of a quarter or four times changed errors
   without fixes by a tenth at most. More, at worst five to seven tenths on one of the drives, cost slow errors or
   `vehicle.non_holonomic_sigma` stated four times too large, and a `gnss.sigma` of a fifth (with 96 % in the ellipse)
   or five times. For comparison: a time offset that is half a second wrong made errors two to three and a half times as
   large ([each of them](ablation.md#a-params-file-that-is-wrong)). `configure`, [`diagnose`](closing_the_loop.md) and
   [`characterize`](characterize.md) write the noise.
4. *The rest* are limits and sigmas for rare cases: leave them."""

_TABLES = (('Filter', FILTER), ('fusion_node', FUSION), ('replay_node', REPLAY))


def markdown() -> str:
    """The table as `docs/parameters.md`."""
    lines = ['# Parameters', '', 'Written by `python -m mems_ins_fusion.parameters > docs/parameters.md`.', '',
             'SI units and radians. One params file may hold the parameters of every tool.', '', _WHICH]
    for title, table in _TABLES:
        lines += ['', f'## {title}', '', '| name | default | unit | allowed | meaning |', '|---|---|---|---|---|']
        for p in table:
            cells = (f'`{p.name}`', f'`{yaml_value(p.default)}`', p.unit, _allowed(p), p.description)
            lines.append('| ' + ' | '.join(cell.replace('|', r'\|') for cell in cells) + ' |')
    return '\n'.join(lines) + '\n'


def example() -> str:
    """The defaults of filter and node as a commented params file, `config/fusion.yaml`."""
    lines = ['# Every parameter of fusion_node at its default: delete what you do not change.',
             '# Written by `python -m mems_ins_fusion.parameters --yaml > config/fusion.yaml`.',
             '/**:', '  ros__parameters:']
    for p in (*FILTER, *FUSION):
        allowed = f' Allowed: {_allowed(p)}.' if _allowed(p) else ''
        unit = f'[{p.shown_unit}] ' if p.shown_unit else ''
        lines += ['', *textwrap.wrap(unit + p.description + allowed, 110, initial_indent='    # ',
                                     subsequent_indent='    # '),
                  f'    {p.name}: {yaml_value(p.default)}']
    return '\n'.join(lines) + '\n'


def _allowed(p: Parameter) -> str:
    """The range of `p` in words; empty if any value is allowed, or the description contains the range."""
    if p.choices:
        return ', '.join(p.choices)
    if p.positive:
        bounds = ['not empty' if p.unit == 'text' else 'above 0']
    else:
        bounds = [f'from {p.minimum:g}'] if p.minimum > -math.inf else []
    if p.maximum < math.inf:
        bounds.append(f'to {p.maximum:g}')
    return ' '.join(bounds)


if __name__ == '__main__':
    sys.stdout.write(example() if '--yaml' in sys.argv else markdown())
