"""From the command line to a running node and to a clean exit, for all nodes of the package."""
from __future__ import annotations

import errno
import os
import re
import signal
import sys
import textwrap
from collections.abc import Callable

import rclpy
from rclpy._rclpy_pybind11 import RCLError, UnknownROSArgsError
from rclpy.exceptions import NameValidationException, ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.logging import LoggingSeverity, get_logger_level, set_logger_level
from rclpy.node import Node
from rclpy.qos_overriding_options import InvalidQosOverridesError
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from ..errors import InputError
from ..guard import one_line
from ..hints import VERSION
from ..parameters.parameter import Parameter, ParameterError
from ..parameters.params_file import load_yaml, yaml_value
from .ros_parameters import params_files

#: ROS arguments, for a hint to users who leave out --ros-args
_ROS_OPTIONS = ('--params-file', '-p', '--param', '-r', '--remap', '--log-level')
#: exceptions for errors of the user, as opposed to defects of the program
_USER_ERRORS = (InputError, ParameterException, NameValidationException, InvalidQosOverridesError)


class Stop:
    """SIGINT and SIGTERM as a request: `requested` is true after one has come.

    While `interrupts` is true, the first signal also raises KeyboardInterrupt. It is true only in plain Python, since
    an exception within an rclpy call, the compiler or a shutdown leaves a traceback or worse. Further signals are
    ignored: ros2 launch and impatient users send several.
    """

    def __init__(self):
        self.requested = False
        self.interrupts = False
        signal.signal(signal.SIGINT, self._handle)
        signal.signal(signal.SIGTERM, self._handle)

    def _handle(self, number, frame):
        first, self.requested = not self.requested, True
        if first and self.interrupts:
            raise KeyboardInterrupt


def spin(node: Node, stop: Stop) -> None:
    """Serve the callbacks of `node` until `stop` is requested; needs a steady timer in the node that wakes it."""
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    while not stop.requested:
        executor.spin_once()


def serve(name: str, make_node: Callable[[list[str], Stop], Node], argv: list[str],
          work: Callable[[Node, Stop], None], tables: tuple[tuple[Parameter, ...], ...]) -> int:
    """As `run`, for a node that works until a signal comes; the process then ends at once, with status 0.

    Python's own end would delete all that is loaded, compiled functions above all: a second of CPU time, which took
    more than a minute on a busy computer. Nothing is left to do by then.
    """
    stop = Stop()
    status = run(name, make_node, argv, work, tables, stop)
    if stop.requested:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(status)
    return status


def run(name: str, make_node: Callable[[list[str], Stop], Node], argv: list[str],
        work: Callable[[Node, Stop], int | None], tables: tuple[tuple[Parameter, ...], ...],
        stop: Stop | None = None) -> int:
    """Make the node with `make_node(argv, stop)` and run `work(node, stop)`. Returns the exit status.

    tables: the node's parameters, for --help. The exit status is 0 after a signal, that of `work` (None is 0) if it
    returns by itself, and 2, with one line on stderr, if `argv` or the parameters are wrong.
    """
    if '--version' in argv:
        print(VERSION)
        return 0
    if {'-h', '--help'} & set(argv):
        print(usage(name, tables))
        return 0
    stop = stop or Stop()
    node = None
    try:
        try:
            _initialize(name, argv)
            node = make_node(argv, stop)
        except _USER_ERRORS as error:
            print(f'{name}: {one_line(error)}', file=sys.stderr)
            return 2
        return 0 if stop.requested else work(node, stop) or 0
    except KeyboardInterrupt:
        return 0
    finally:
        stop.interrupts = False
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()


def usage(name: str, tables: tuple[tuple[Parameter, ...], ...]) -> str:
    """How the node `name` is started, and its parameters with unit, default and meaning."""
    lines = [f'usage: python -m mems_ins_fusion {name} [--help] [--version] [--ros-args [--params-file FILE] '
             '[-p NAME:=VALUE] ...]', f'or:    ros2 run mems_ins_fusion {name} ...', '',
             'parameters:']
    for parameter in (p for table in tables for p in table):
        lines.append(f'  {parameter.name} = {yaml_value(parameter.default)} {parameter.shown_unit}'.rstrip())
        choices = f" ({', '.join(parameter.choices)})" if parameter.choices else ''
        lines += textwrap.wrap(parameter.description + choices, 110, initial_indent=' ' * 6,
                               subsequent_indent=' ' * 6)
    return '\n'.join(lines)


def _initialize(name, argv):
    """Call rclpy.init; errors in `argv` are raised as ParameterError."""
    set_logger_level('rcl', LoggingSeverity.FATAL)  # it would log the same error in its own words
    for path in params_files(argv):
        if path.exists() and not path.is_file():  # rcl would wait for ever for the content of a pipe
            raise ParameterError(f'params file {path} is not a file')
    _check_log_folder()
    try:
        others = remove_ros_args(argv)
        if others and others[0] in _ROS_OPTIONS:
            raise ParameterError(f"'{others[0]}' is a ROS argument: write --ros-args before it")
        if others:
            raise ParameterError(f"'{others[0]}' is not understood: {name} takes ROS arguments only, "
                                 'such as --ros-args --params-file FILE -p NAME:=VALUE')
        rclpy.init(args=argv, signal_handler_options=SignalHandlerOptions.NO)
    except UnknownROSArgsError as error:
        raise ParameterError(f'unknown ROS arguments {error}') from None
    except RCLError as error:
        raise ParameterError(_explain(error, argv)) from None
    if get_logger_level('rcl') == LoggingSeverity.FATAL:
        set_logger_level('rcl', LoggingSeverity.UNSET)


def _check_log_folder() -> None:
    """Raise ParameterError if ROS cannot write its log: rclpy.init would fail, and the process would not end."""
    home = os.environ.get('ROS_HOME') or os.path.join('~', '.ros')
    folder = os.path.expanduser(os.environ.get('ROS_LOG_DIR') or os.path.join(home, 'log'))
    try:
        os.makedirs(folder, exist_ok=True)
        if not os.access(folder, os.W_OK):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
    except OSError as error:
        raise ParameterError(f'ROS cannot write its log to {folder}: {error.strerror}; set ROS_LOG_DIR to a folder '
                             'that can be written') from None


def _explain(error, argv) -> str:
    """rcl's error message in plain words. Raises ParameterError where this package's reader of params files has a
    better message."""
    for path in params_files(argv):
        for name, value in load_yaml(path).items():
            if isinstance(value, list) and len({type(v) for v in value}) > 1:
                raise ParameterError(f"params file {path}: ROS accepts no list of mixed types, as in '{name}': "
                                     f'{value}; write whole numbers with a decimal point')
    # rcl: "failed to initialize rcl: REASON, at FILE:LINE, at FILE:LINE"
    reason = re.sub(r', at \S+:\d+', '', str(error)).removeprefix('failed to initialize rcl: ')
    if 'Sequence should be of same type' in reason:
        reason += ' (write whole numbers in a list of decimals with a decimal point)'
    return reason
