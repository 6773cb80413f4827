"""replay_node: runs the filter of the live node over recordings, with each sensor error model, against a reference.

This file has the parameters, the progress bar and the exit status; the work is in `reports.replay`.
"""
from __future__ import annotations

import sys

from rclpy.node import Node

from ..errors import InputError
from ..evaluation.verdict import NOT_USABLE
from ..guard import BAD_INPUT, INTERRUPTED, refuse
from ..parameters.parameter import ParameterError
from ..parameters.table import FILTER, REPLAY
from ..progress import Progress
from .ros_parameters import declare
from .run import Stop, run

NAME = 'replay_node'


class ReplayNode(Node):
    """The parameters of one replay; `argv` names its params files. Raises ParameterError for wrong parameters."""

    def __init__(self, argv: list[str], stop: Stop):
        super().__init__(NAME)
        self._values = declare(self, argv, (*FILTER, *REPLAY))
        for name in ('bag', 'output_dir'):
            if not self._values[name]:
                raise ParameterError(f"parameter '{name}' is missing: -p bag:=RECORDING -p output_dir:=FOLDER")

    def replay(self, stop: Stop) -> int:
        """Replay and print the result; returns the exit status."""
        from ..reports.replay import replay_recordings

        stop.interrupts = True
        try:
            with Progress(NAME) as tell:
                result = replay_recordings(self._values, _interruptible(tell, stop))
            _tell(result, self._values['verbose'])
        except InputError as error:
            return refuse(NAME, error)
        except KeyboardInterrupt:
            print(f'{NAME}: interrupted, nothing was written', file=sys.stderr)
            return INTERRUPTED
        stop.interrupts = False
        if self._values['publish']:
            self._publish(result, stop)
        # as in diagnose: data or parameters are certainly wrong, and the page says why
        return BAD_INPUT if result.content['verdict']['answer'] == NOT_USABLE else 0

    def _publish(self, result, stop: Stop) -> None:
        """Publish one recording after the other, each model at the shortest update interval, until the end or a signal.
        """
        from ..reports.replay import origin
        from ..reports.trajectories import odometry_of
        from .playback import play

        for comparison in result.comparisons.values():
            datum, interval = origin(comparison, self._values), comparison.intervals[0]
            tracks = {m: odometry_of(comparison.recording, comparison.run_of(m, interval), datum)
                      for m in comparison.models}
            print(f"publishing {', '.join(f'/odometry/{m}' for m in tracks)} and /clock", flush=True)
            play(self, tracks, self._values['rate'], lambda: stop.requested, self._values['frame_id'],
                 self._values['child_frame_id'])


def _tell(result, verbose: bool) -> None:
    """Print the answer and the path of the results; verbose: also the errors, and the comparison of the models."""
    from ..reports.replay_report import summary_table

    for recording in result.content['recordings']:
        for warning in recording['warnings']:
            print(f'{NAME}: {warning}', file=sys.stderr)
    for name, answer in result.answers.items():
        lines = answer.lines() if verbose else answer.short()
        print(*([f'{name}:'] if len(result.answers) > 1 else []), *lines, sep='\n')
    if verbose:
        print(f'\n{summary_table(result.content)}')
        for sentences in result.content['sentences'].values():
            print(*sentences, sep='\n')
        for picture in sorted(result.folder.glob('*track.png')):
            print(f'track: {picture}')
    print(f'report: {result.folder / "report.html"}')


def _interruptible(tell: Progress, stop: Stop):
    """`tell` that raises KeyboardInterrupt after a signal: the exception of the signal handler may have been lost in a
    callback of a library."""
    def told(part: float, what: str) -> None:
        if stop.requested:
            raise KeyboardInterrupt
        tell(part, what)
    return told


def main(argv: list[str]) -> int:
    """Replay as specified by the parameters in `argv`; returns the exit status."""
    return run(NAME, ReplayNode, argv, ReplayNode.replay, (FILTER, REPLAY))
