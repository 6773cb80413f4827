"""`completion`: a script that lets a shell complete tools, options and parameters."""
from __future__ import annotations

import argparse
from importlib import import_module

from mems_ins_fusion.cli.command import Parser, run
from mems_ins_fusion.parameters.table import FILTER, FUSION, REPLAY
from mems_ins_fusion.tools import TOOLS

DESCRIPTION = """\
Print a script that completes the command mems_ins_fusion: tools, options, their values, and the parameters of the nodes
after -p. For this terminal, or in ~/.bashrc or ~/.zshrc for each:

  source <(mems_ins_fusion completion)"""

_PARAMETERS = {'fusion_node': (*FILTER, *FUSION), 'replay_node': (*FILTER, *REPLAY)}
_ROS_OPTIONS = ('--help', '--version', '--ros-args', '--params-file', '-p', '-r', '--log-level')

_SCRIPT = """\
# completion of mems_ins_fusion for bash and zsh, written by `mems_ins_fusion completion`
if [ -n "$ZSH_VERSION" ]; then
    autoload -U +X compinit bashcompinit && compinit -u && bashcompinit
fi
_mems_ins_fusion() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" before="${{COMP_WORDS[COMP_CWORD-1]}}" words=''
    if [ "$COMP_CWORD" = 1 ]; then
        words='{tools} --help --version'
    else
        case "${{COMP_WORDS[1]}} $before" in
{cases}
        esac
    fi
    COMPREPLY=($(compgen -W "$words" -- "$word"))
}}
complete -o default -F _mems_ins_fusion mems_ins_fusion"""


def main(argv: list[str] | None = None) -> int:
    """Run the tool with `argv` (default: the command line); its exit status."""
    return run(_parser(), lambda options: script(), argv)


def script() -> str:
    """The script, for bash and zsh. Where it knows no word, the shell completes the names of files."""
    cases = [line for tool in TOOLS for line in (_node(tool) if tool in _PARAMETERS else _tool(tool))]
    return _SCRIPT.format(tools=' '.join(TOOLS), cases='\n'.join(f'        {line}' for line in cases))


def _node(tool: str) -> list[str]:
    names = ' '.join(f'{parameter.name}:=' for parameter in _PARAMETERS[tool])
    return [f"'{tool} -p') words='{names}'; compopt -o nospace 2>/dev/null ;;",
            f"'{tool} --params-file') ;;", _rest(tool, _ROS_OPTIONS)]


def _tool(tool: str) -> list[str]:
    actions = import_module(f'mems_ins_fusion.{TOOLS[tool][0]}.{tool}')._parser()._actions
    options: dict[str, list[str]] = {}
    for action in actions:
        if action.nargs != 0:  # it takes a value
            options.setdefault(' '.join(map(str, action.choices or ())), []).extend(action.option_strings)
    values = [f"{_patterns(tool, of_these)}) words='{choices}' ;;"
              for choices, of_these in options.items() if of_these]
    return [*values, _rest(tool, [o for action in actions for o in action.option_strings if o.startswith('--')])]


def _patterns(tool: str, options: list[str]) -> str:
    return '|'.join(f"'{tool} {option}'" for option in options)


def _rest(tool: str, options) -> str:
    return f"'{tool} '*) words='{' '.join(options)}' ;;"


def _parser() -> argparse.ArgumentParser:
    return Parser('completion', DESCRIPTION)
