"""What all tools have alike: options, versions, hints, progress, completion."""
from __future__ import annotations

import contextlib
import io
import os
import shutil
import subprocess
import sys
from importlib import import_module

import pytest
from terminal_support import Terminal

from mems_ins_fusion import __version__, progress
from mems_ins_fusion.__main__ import main
from mems_ins_fusion.cli import completion
from mems_ins_fusion.parameters import params_file
from mems_ins_fusion.parameters.parameter import ParameterError
from mems_ins_fusion.parameters.table import check
from mems_ins_fusion.tools import TOOLS

NODES = ('fusion_node', 'replay_node')


def said(capsys, *argv):
    """Status and standard error of a tool."""
    try:
        status = main(list(argv))
    except SystemExit as end:
        status = end.code
    return status, capsys.readouterr().err


@pytest.mark.parametrize('tool', ['', *TOOLS])
def test_each_tool_tells_its_version_and_its_options(tool, capsys):
    argv = [tool] if tool else []
    for option, begin in (('--version', f'mems_ins_fusion {__version__}\n'),
                          ('--help', f'usage: python -m mems_ins_fusion {tool}'.rstrip())):
        with contextlib.suppress(SystemExit):
            assert main([*argv, option]) == 0
        assert capsys.readouterr().out.startswith(begin)


@pytest.mark.parametrize(['argv', 'meant'], [
    (['simulat'], 'simulate'), (['replay'], 'replay_node'),
    (['simulate', '--ouput', 'x'], '--output'), (['simulate', '--ouput=x'], '--output'),
    (['diagnose', '--bag', 'x', '--output', 'y', '--param-file', 'z'], '--params-file'),
    (['simulate', '--output', 'x', '--effect', 'gyroscop_scale=1'], 'gyroscope_scale'),
    (['fusion_node', '--ros-args', '-p', 'gnss.leverarm:=[1.0, 0.0, 0.0]'], 'gnss.lever_arm')])
def test_a_misspelled_name_is_answered_with_the_one_meant(argv, meant, capsys):
    status, text = said(capsys, *argv)
    assert status == 2, text
    assert text.splitlines()[-1].startswith(f'{argv[0]}: ' if argv[0] in TOOLS else 'no tool')
    assert f"did you mean '{meant}'?" in text
    assert len(text.splitlines()) == 1 or argv[0] not in TOOLS, text


@pytest.mark.parametrize('argv', [['diagnose', 'my bag'], ['diagnose', '--output', 'x', 'my bag'],
                                  ['configure', '--overwrite', 'my bag', '--output', 'x'], ['characterize', 'my bag'],
                                  ['bench', 'prepare', '--outage-durations', '10', '30', '--output=x', 'my bag']])
def test_a_recording_without_its_option_is_answered_with_what_to_write(argv, capsys):
    status, text = said(capsys, *argv)
    assert status == 2 and "no option before 'my bag': write --bag 'my bag'" in text


def test_further_values_of_an_option_are_no_recordings(capsys):
    status, text = said(capsys, 'bench', 'prepare', '--outage-durations', '10', '-30', '60', '--output', 'x')
    assert status == 2 and 'write --bag' not in text and '--bag' in text, text


@pytest.mark.parametrize(['words', 'hint'], [
    (['--gnss-topic', '/fix'], 'gnss_topic is a parameter; write it into a file and give that with --params-file'),
    (['--gnss.sigma=2'], 'gnss.sigma is a parameter; write it into a file and give that with --params-file'),
    (['-p', 'gnss.sigma:=2'], "'-p' is for nodes: parameters are given in a file, with --params-file")])
def test_a_parameter_given_as_an_option_is_answered_with_the_file(words, hint, capsys):
    status, text = said(capsys, 'diagnose', '--bag', 'x', '--output', 'y', *words)
    assert status == 2 and hint in text and len(text.splitlines()) == 1, text
    # and not by a tool that takes no such file
    assert 'params-file' not in said(capsys, 'configure', '--bag', 'x', '--output', 'y', *words)[1]


def test_a_misspelled_parameter_of_a_file_is_answered_too():
    with pytest.raises(ParameterError, match="did you mean 'gnss.max_delay'"):
        check({'gnss.maxdelay': 1.0})
    # but a name of which only the group is right is like no other one of the group
    with pytest.raises(ParameterError, match="unknown parameter 'gnss.antenna'$"):
        check({'gnss.antenna': 1.0})


def test_a_node_started_without_ros_args_says_what_is_missing(capsys):
    status, text = said(capsys, 'fusion_node', '--params-file', 'my_car.yaml')
    assert status == 2 and 'write --ros-args before it' in text


@pytest.mark.parametrize('tool', [tool for tool in TOOLS if tool not in NODES])
def test_options_have_one_style(tool):
    parser = import_module(f'mems_ins_fusion.{TOOLS[tool][0]}.{tool}')._parser()
    for action in parser._actions:
        long = [option for option in action.option_strings if option.startswith('--')]
        assert long or not action.option_strings
        assert all(option == option.lower() and '_' not in option for option in long)
        assert action.help or action.choices or action.metavar
    assert not parser.allow_abbrev


def test_of_several_params_files_the_later_one_counts(tmp_path):
    for name, text in (('preset', 'gnss_topic: /a\n    imu_topic: /b'), ('own', 'imu_topic: /c')):
        (tmp_path / name).write_text(f'/**:\n  ros__parameters:\n    {text}\n')
    assert params_file.load_files([tmp_path / 'preset', tmp_path / 'own']) == {'gnss_topic': '/a', 'imu_topic': '/c'}
    assert params_file.load_files([]) == {}


def told(monkeypatch, stream, moments):
    """What a Progress writes to `stream`, called at `moments` (s)."""
    monkeypatch.setattr(sys, 'stderr', stream)
    clock = iter([0.0, *moments])
    monkeypatch.setattr(progress.time, 'monotonic', lambda: next(clock))
    with progress.Progress('tool') as tell:
        for i in range(len(moments)):
            tell(i / len(moments), 'reading')


def test_in_a_log_progress_is_a_line_now_and_then(monkeypatch):
    log = io.StringIO()
    told(monkeypatch, log, [1.0, 10.0, 21.0, 30.0, 45.0])
    assert log.getvalue() == 'tool: 40 %, reading, 21 s\ntool: 80 %, reading, 45 s\n'


def test_on_a_terminal_progress_is_a_bar():
    code = ('import time\nfrom mems_ins_fusion.progress import Progress\n'
            'with Progress("tool") as tell:\n    tell(0.5, "reading"); time.sleep(0.1); tell(1.0, "done")\n')
    with Terminal() as terminal:
        subprocess.run([sys.executable, '-c', code], stderr=terminal.end, check=True)
        os.close(terminal.end)
        text = b''.join(iter(terminal.read, b'')).decode()
    assert '50%|' in text and 'reading' in text and '100%|' in text


def completed(shell, words):
    """What `shell` offers for the last of `words`."""
    if shutil.which(shell) is None:
        pytest.skip(f'{shell} is not installed')
    quoted = ' '.join(f"'{word}'" for word in words)
    arrays = 'setopt KSH_ARRAYS\n' if shell == 'zsh' else ''  # as bashcompinit sets it for the function
    call = (f'COMP_WORDS=({quoted}); COMP_CWORD={len(words) - 1}\n'
            '_mems_ins_fusion; printf "%s\\n" "${COMPREPLY[@]}"')
    script = f'{completion.script()}\n{arrays}{call}'
    run = subprocess.run([shell, '-c', script], capture_output=True, text=True, check=True)
    assert run.stderr == ''
    # zsh itself leaves out what does not begin with the word
    return [word for word in run.stdout.split() if word.startswith(words[-1])]


@pytest.mark.parametrize('shell', ['bash', 'zsh'])
@pytest.mark.parametrize(['words', 'offered'], [
    (['co'], ['configure', 'compare', 'compile', 'completion']), (['simulate', '--drive', ''], ['flat', 'realistic']),
    (['diagnose', '--ref'], ['--reference-topic', '--reference-file']), (['characterize', '--bag', ''], []),
    (['fusion_node', '--ros-args', '-p', 'gnss.time'],
     ['gnss.time_offset:=', 'gnss.time_offset_sigma:=', 'gnss.time_offset_walk:=']),
    (['replay_node', '--ros-args', '-p', 'write_b'], ['write_bag:=']), (['play', '--lo'], ['--loop'])])
def test_a_shell_completes(shell, words, offered):
    assert completed(shell, ['mems_ins_fusion', *words]) == offered
