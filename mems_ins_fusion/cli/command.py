"""Common code of all tools with ordinary options: option parser, error messages, exit status."""
from __future__ import annotations

import argparse
import math
import shlex
import sys
from collections.abc import Callable

from mems_ins_fusion.errors import InputError
from mems_ins_fusion.guard import one_line, refuse
from mems_ins_fusion.hints import VERSION, did_you_mean


class Parser(argparse.ArgumentParser):
    """The options of the tool `tool`. Wrong usage is one line on standard error and status 2."""

    def __init__(self, tool: str, description: str, epilog: str | None = None):
        super().__init__(prog=f'python -m mems_ins_fusion {tool}', description=description, epilog=epilog,
                         formatter_class=argparse.RawDescriptionHelpFormatter, allow_abbrev=False)
        self.tool = tool
        self.add_argument('--version', action='version', version=VERSION)

    def parse_known_args(self, args=None, namespace=None):
        # check for unknown options before missing ones: a missing option is often misspelled
        words = list(sys.argv[1:] if args is None else args)
        for word in words:
            option = word.partition('=')[0]
            if option.startswith('--') and option != '--' and option not in self._option_string_actions:
                known = [name for name in self._option_string_actions if name.startswith('--')]
                hint = self._in_params_file(option.removeprefix('--')) or did_you_mean(option, known)
                self.error(f"unknown option '{option}'{hint}")
            if word in ('-p', '--ros-args') and '--params-file' in self._option_string_actions:
                self.error(f"'{word}' is for nodes: parameters are given in a file, with --params-file")
        loose = self._without_option(words)
        if loose and '--bag' in self._option_string_actions and not any(w.startswith('--bag') for w in words):
            self.error(f"no option before '{loose}': write --bag {shlex.quote(loose)}")
        return super().parse_known_args(args, namespace)

    def _without_option(self, words: list[str]) -> str:
        """The first of `words` that is neither an option nor the value of one; '' if the tool takes such words."""
        if self._get_positional_actions():
            return ''
        free = 0.0  # number of words that the last option still takes
        for word in words:
            if word in self._option_string_actions:
                number = self._option_string_actions[word].nargs
                free = {None: 1, '?': 1, '*': math.inf, '+': math.inf}.get(number, number)
            elif word.startswith('--'):  # --option=value
                free = 0.0
            elif free > 0.0:
                free -= 1.0
            elif not word.startswith('-'):
                return word
        return ''

    def _in_params_file(self, name: str) -> str:
        """Hint that `name` is a parameter, not an option; '' where it is none, or no file of them is taken."""
        from mems_ins_fusion.parameters import table

        known = {one.replace('_', '-'): one for one in table.defaults()}
        parameter = known.get(name.replace('_', '-'))
        if parameter is None or '--params-file' not in self._option_string_actions:
            return ''
        return f': {parameter} is a parameter; write it into a file and give that with --params-file'

    def error(self, message: str):
        self.exit(2, f'{self.tool}: {one_line(message)} (--help shows all options)\n')

    def add_params_file(self, what: str) -> None:
        """--params-file, which may be given several times; `what` is in it."""
        self.add_argument('--params-file', action='append', default=[], metavar='FILE',
                          help=f'YAML with {what}, as for the nodes; repeatable, the later one counts')

    def add_verbose(self) -> None:
        """--verbose."""
        self.add_argument('--verbose', action='store_true', help='print all that was found, as on the page')

    def add_overwrite(self) -> None:
        """--overwrite."""
        self.add_argument('--overwrite', action='store_true', help='replace an existing result')


def run(parser: Parser, work: Callable[[argparse.Namespace], str | tuple[str, int]], argv: list[str] | None) -> int:
    """Parse `argv` (None: the command line) and print what `work` returns, with an exit status where that is not 0.
    Returns the exit status.

    An InputError in `work` is printed as one line, with exit status 2.
    """
    options = parser.parse_args(argv)
    try:
        said = work(options)
    except InputError as error:
        return refuse(parser.tool, error)
    text, status = said if isinstance(said, tuple) else (said, 0)
    print(text)
    return status
