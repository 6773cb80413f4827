"""`python -m mems_ins_fusion NAME ...`: every tool of the package under one command."""
from __future__ import annotations

import os
import signal
import sys
from importlib import import_module

from mems_ins_fusion.guard import guarded
from mems_ins_fusion.hints import VERSION, did_you_mean
from mems_ins_fusion.tools import TOOLS


def usage() -> str:
    """One line per tool."""
    lines = [f'  {name:<13} {purpose}' for name, (_, purpose) in TOOLS.items()]
    return '\n'.join(['usage: python -m mems_ins_fusion NAME ...', '       NAME --help tells its options', '', *lines])


def _end_quietly_on_signals() -> None:
    """Until a node takes over SIGINT and SIGTERM there is nothing to clean up, and nothing to say."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: os._exit(0))


def main(argv: list[str] | None = None) -> int:
    """Run the tool that argv[0] names with the rest of `argv` (default: the command line); its exit status."""
    argv = sys.argv[1:] if argv is None else argv
    if argv and argv[0] in ('-h', '--help'):
        print(usage())
        return 0
    if argv and argv[0] == '--version':
        print(VERSION)
        return 0
    if not argv or argv[0] not in TOOLS:
        hint = did_you_mean(argv[0], TOOLS) if argv else ''
        if not hint:
            print(usage(), file=sys.stderr)
        if argv:
            print(f"no tool is named '{argv[0]}'{hint}", file=sys.stderr)
        return 2
    return guarded(argv[0], argv[1:], lambda: _run(argv))


def _run(argv: list[str]) -> int | None:
    package, _ = TOOLS[argv[0]]
    if package == 'nodes':
        _end_quietly_on_signals()
    # imported only now: a tool must not wait for, or fail with, what only another one needs
    try:
        tool = import_module(f'mems_ins_fusion.{package}.{argv[0]}')
    except ModuleNotFoundError as error:
        if error.name.startswith('mems_ins_fusion'):
            raise
        ros = "; source ROS 2's setup file, or install the package with [ros]" if package == 'nodes' else ''
        print(f"{argv[0]}: the Python module '{error.name}' is not installed{ros}", file=sys.stderr)
        return 2
    return tool.main(argv[1:])


if __name__ == '__main__':
    sys.exit(main())
