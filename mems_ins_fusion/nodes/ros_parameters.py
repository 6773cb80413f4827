"""Declares the table of parameters as ROS 2 parameters, with range and unit; refuses wrong names and values."""
from __future__ import annotations

import math
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter as RosParameter

from ..filter.measurements.registry import named_parameters
from ..parameters.parameter import Parameter, ParameterError
from ..parameters.params_file import read_yaml
from ..parameters.table import ALL, check


def declare(node: Node, argv: list[str], table: Iterable[Parameter],
            changeable: frozenset[str] = frozenset()) -> dict:
    """Declare `table` on `node` and return every parameter of the package, checked, as `parameters.table.check` does.

    Values given on the command line `argv` or in params files are checked here and not by rclpy, which would refuse
    a whole number for a double and silently ignore unknown names. Names of the package's other tools are accepted:
    one file configures a vehicle. All are read-only but `changeable`. Raises ParameterError.
    """
    _refuse_files_for_others(node, argv)
    values = check(_given(node))
    for parameter in (*table, *named_parameters(values, ALL).values()):
        _declare_one(node, parameter, values[parameter.name], parameter.name not in changeable)
    return values


def _given(node: Node) -> dict:
    """The parameters that the user set, without those of ROS itself (use_sim_time, qos_overrides...)."""
    return {name: parameter.value for name, parameter in node._parameter_overrides.items()
            if not (node.has_parameter(name) or name.startswith('qos_overrides.'))}


def _declare_one(node, parameter, value, read_only):
    if value != []:
        node.declare_parameter(parameter.name, value, describe(parameter, read_only), ignore_override=True)
        return
    # rclpy cannot tell the type of an empty list: declare by type, set, and only then protect it
    kind = RosParameter.Type.STRING_ARRAY if parameter.unit == 'text' else RosParameter.Type.DOUBLE_ARRAY
    node.declare_parameter(parameter.name, kind, describe(parameter, False), ignore_override=True)
    node.set_parameters([RosParameter(parameter.name, kind, [])])
    descriptor = describe(parameter, read_only)
    descriptor.type = kind.value
    node.set_descriptor(parameter.name, descriptor)


def describe(parameter: Parameter, read_only: bool) -> ParameterDescriptor:
    """Meaning, unit and range of `parameter` as `ros2 param describe` shows them."""
    unit = f'[{parameter.shown_unit}] ' if parameter.shown_unit else ''
    descriptor = ParameterDescriptor(description=unit + parameter.description, read_only=read_only,
                                     additional_constraints=_constraints(parameter))
    if math.isfinite(parameter.minimum) or math.isfinite(parameter.maximum):
        if isinstance(parameter.default, float):
            descriptor.floating_point_range = [
                FloatingPointRange(from_value=parameter.minimum, to_value=parameter.maximum)]
        elif isinstance(parameter.default, int):
            highest = parameter.maximum if math.isfinite(parameter.maximum) else 2**63 - 1
            descriptor.integer_range = [IntegerRange(from_value=int(parameter.minimum), to_value=int(highest))]
    return descriptor


def _constraints(parameter):
    """Limits that ROS's ranges cannot express, in words."""
    constraints = []
    if parameter.choices:
        constraints.append('one of ' + ', '.join(parameter.choices))
    if parameter.positive:
        constraints.append('not empty' if parameter.unit == 'text' else 'above 0')
    if parameter.lengths is not None:
        constraints.append(f'{parameter.length_text} values')
    return '; '.join(constraints)


def refuse_unused_qos_overrides(node: Node, later: Iterable[str] = ()) -> None:
    """Raise ParameterError for a QoS override of a topic that `node` does not use; call it when `node` is complete.

    later: topics to which it will subscribe when a publisher shows their type.
    """
    known = tuple(f'qos_overrides.{topic}.subscription.' for topic in later)
    for name in node._parameter_overrides:
        if name.startswith('qos_overrides.') and not (node.has_parameter(name) or name.startswith(known)):
            known = sorted(n for n in node._parameters if n.startswith('qos_overrides.'))
            raise ParameterError(f"unknown parameter '{name}'; there are {', '.join(known)}")


def params_files(argv: list[str]) -> list[Path]:
    """The files given with --params-file."""
    return [Path(value) for option, value in zip(argv, argv[1:]) if option == '--params-file']


def _refuse_files_for_others(node: Node, argv: list[str]) -> None:
    """Raise ParameterError for a params file without a section for `node`: ROS ignores such a file silently."""
    name = node.get_fully_qualified_name()
    for path in params_files(argv):
        content = read_yaml(path)
        sections = list(_sections(content)) if isinstance(content, dict) else []
        if not sections:
            raise ParameterError(f'params file {path} holds no parameters')
        if not any(_matches(section, name) for section in sections):
            raise ParameterError(f"params file {path} holds nothing for the node '{name}', "
                                 f"only for {', '.join(sections)}")


def _sections(tree: dict, prefix: str = '') -> Iterator[str]:
    """Names of the nodes (patterns with * and **) that have a section in a params file."""
    for key, value in tree.items():
        name = f"{prefix}/{str(key).strip('/')}"
        if isinstance(value, dict):
            if 'ros__parameters' in value:
                yield name
            else:
                yield from _sections(value, name)


def _matches(section: str, name: str) -> bool:
    pattern = re.escape(section).replace(r'/\*\*', '(/.*)?').replace(r'\*', '[^/]+')
    return re.fullmatch(pattern, name) is not None
