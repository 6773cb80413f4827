"""ROS 2 params files: read without ROS, and values written as ROS reads them back."""
from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

import yaml

from mems_ins_fusion.errors import InputError
from mems_ins_fusion.guard import one_line

from .parameter import ParameterError

#: bytes, largest file that is read: files by people and recorders are far smaller
_LARGEST = 1_000_000
#: largest number of nested levels that is read: such files have far fewer
_DEEPEST = 20


class YamlError(InputError):
    """Text that is not valid YAML, or YAML that is not supported; the message says why in one line."""


class _Loader(yaml.SafeLoader):
    """As rcl reads YAML: no aliases (a few lines of them unfold to gigabytes), dates are texts, no deep nesting."""

    yaml_implicit_resolvers = {first: [(tag, pattern) for tag, pattern in resolvers if not tag.endswith(':timestamp')]
                               for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()}
    depth = 0

    def compose_node(self, parent, index):
        if self.check_event(yaml.AliasEvent):
            raise YamlError(f'line {self.peek_event().start_mark.line + 1}: aliases (*) are not read')
        if self.depth == _DEEPEST:
            raise YamlError(f'line {self.peek_event().start_mark.line + 1}: nested more than {_DEEPEST} levels deep')
        self.depth += 1
        node = super().compose_node(parent, index)
        self.depth -= 1
        return node


def read_yaml(path):
    """The document in the YAML file `path`. Raises OSError if it cannot be read, YamlError if it is not usable."""
    if Path(path).exists() and not Path(path).is_file():  # reading from a pipe could wait for ever
        raise YamlError('it is not a file')
    with Path(path).open('rb') as file:
        data = file.read(_LARGEST + 1)
    if len(data) > _LARGEST:
        raise YamlError(f'it is larger than {_LARGEST / 1e6:g} MB')
    try:
        loader = _Loader(data.decode())
        try:
            return loader.get_single_data()
        finally:
            loader.dispose()
    except YamlError:
        raise
    # PyYAML passes on what Python says of values such as !!int with no digits
    except (yaml.YAMLError, ValueError, TypeError, LookupError, AttributeError, OverflowError) as error:
        mark, problem = getattr(error, 'problem_mark', None), getattr(error, 'problem', None)
        where = f'line {mark.line + 1}: ' if mark is not None and problem else ''
        raise YamlError(one_line(f'{where}{problem or error}')) from None


def load_yaml(path) -> dict:
    """The parameters in a ROS 2 params file as a flat dictionary of given names, unchecked.

    The parameters of all sections are combined; the section of a node has precedence over `/**`. Raises ParameterError.
    """
    path = Path(path)
    try:
        document = read_yaml(path)
    except OSError as error:
        raise ParameterError(f'params file {path}: {error.strerror}') from None
    except YamlError as error:
        raise ParameterError(f'params file {path} is not valid YAML: {error}') from None
    if not isinstance(document, dict) or not document:
        raise ParameterError(f'params file {path} holds no parameters')
    values: dict = {}
    for _, section in sorted(document.items(), key=lambda item: (item[0] != '/**', str(item[0]))):
        if not isinstance(section, dict) or not isinstance(section.get('ros__parameters'), dict):
            raise ParameterError(f"params file {path}: each node's parameters must stand under 'ros__parameters'")
        values.update(_flatten(section['ros__parameters'], path))
    return values


def load_files(paths: Iterable) -> dict:
    """The parameters of several params files, unchecked; a later file has precedence."""
    values: dict = {}
    for path in paths:
        values.update(load_yaml(path))
    return values


def _flatten(tree: dict, path: Path, prefix: str = '') -> dict:
    flat: dict = {}
    for key, value in tree.items():
        if not isinstance(key, str):
            raise ParameterError(f"params file {path}: '{prefix}{key}' is not the name of a parameter")
        if isinstance(value, dict):
            flat.update(_flatten(value, path, f'{prefix}{key}.'))
        else:
            flat[f'{prefix}{key}'] = value
    return flat


def yaml_value(value) -> str:
    """`value` as text that ROS reads as the same type: floating-point numbers have a point."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(yaml_value(v) for v in value)}]"
    if isinstance(value, str):
        return f"""'{value.replace("'", "''")}'""" if value.isprintable() else json.dumps(value)
    text = repr(value)
    mantissa, exponent, power = text.partition('e')
    return text if not exponent or '.' in mantissa else f'{mantissa}.0e{power}'
