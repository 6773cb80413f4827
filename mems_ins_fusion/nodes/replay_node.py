"""replay_node: recordings through the same filter as the live node, compared with a reference.

The work is in `evaluation.replay`; as a node it takes its parameters as ROS 2 does, from YAML and the command line.
"""
from __future__ import annotations

import sys

from rclpy.node import Node

from ..parameters import FILTER, REPLAY, ParameterError
from .ros_parameters import declare
from .run import Stop, run

NAME = 'replay_node'
_INTERRUPTED = 130  # exit status, as shells have it


class ReplayNode(Node):
    """The parameters of one replay; `argv` names its params files. Raises ParameterError for wrong parameters."""

    def __init__(self, argv: list[str]):
        super().__init__(NAME)
        self._values = declare(self, argv, (*FILTER, *REPLAY))
        for name in ('bag', 'output_dir'):
            if not self._values[name]:
                raise ParameterError(f"parameter '{name}' is missing: -p bag:=RECORDING -p output_dir:=FOLDER")

    def replay(self, stop: Stop) -> int:
        """Replay and print what came out; the exit status."""
        from ..evaluation.replay import replay

        try:
            print(replay(self._values))
        except ValueError as error:
            print(f'{NAME}: {error}', file=sys.stderr)
            return 2
        except KeyboardInterrupt:
            return _INTERRUPTED
        return 0


def main(argv: list[str]) -> int:
    """Replay what the parameters in `argv` ask for; the exit status."""
    return run(NAME, ReplayNode, argv, ReplayNode.replay)
