"""The launch file with stand-ins for `launch`, of which there is no wheel: what it checks before it starts anything."""
from __future__ import annotations

import importlib.util
import sys
import types
from pathlib import Path

import pytest

LAUNCH = Path(__file__).resolve().parents[1] / 'launch' / 'fusion.launch.py'


class Stand:
    """Takes anything; as a LaunchConfiguration it performs to what the context holds."""

    def __init__(self, *arguments, **named):
        self.arguments, self.named = arguments, named

    def perform(self, context):
        return context[self.arguments[0]]


@pytest.fixture
def launch_file(monkeypatch):
    for name in ('launch', 'launch.actions', 'launch.substitutions', 'launch_ros', 'launch_ros.actions',
                 'launch_ros.parameter_descriptions', 'launch_ros.substitutions'):
        module = types.ModuleType(name)
        for made in ('LaunchDescription', 'DeclareLaunchArgument', 'OpaqueFunction', 'LaunchConfiguration',
                     'PathJoinSubstitution', 'Node', 'ParameterValue', 'FindPackageShare'):
            setattr(module, made, type(made, (Stand,), {}))
        monkeypatch.setitem(sys.modules, name, module)
    spec = importlib.util.spec_from_file_location('fusion_launch', LAUNCH)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_params_file_that_does_not_exist_is_refused_before_the_node_starts(launch_file, tmp_path):
    actions = launch_file.generate_launch_description().arguments[0]
    kinds = [type(action).__name__ for action in actions]
    assert kinds.index('OpaqueFunction') < kinds.index('Node')
    check = actions[kinds.index('OpaqueFunction')].named['function']
    there = tmp_path / 'my.yaml'
    there.write_text('/**: {}')
    for absent in ('preset', 'params_file'):
        context = {'preset': str(there), 'params_file': str(there), absent: '/absent/my.yaml'}
        with pytest.raises(RuntimeError, match=rf"{absent} '/absent/my\.yaml' does not exist"):
            check(context)
    assert check({'preset': str(there), 'params_file': str(there)}) is None


def test_the_params_file_counts_more_than_the_preset_and_is_it_where_it_is_not_given(launch_file):
    actions = launch_file.generate_launch_description().arguments[0]
    node = next(action for action in actions if type(action).__name__ == 'Node')
    assert [p.arguments[0] for p in node.named['parameters'][:2]] == ['preset', 'params_file']
    declared = {action.arguments[0]: action.named['default_value'] for action in actions
                if type(action).__name__ == 'DeclareLaunchArgument'}
    assert declared['params_file'].arguments == ('preset',)
