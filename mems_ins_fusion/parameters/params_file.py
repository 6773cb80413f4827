"""ROS 2 params files: read without ROS, and values written as ROS reads them back."""
from __future__ import annotations

from pathlib import Path

import yaml

from .parameter import ParameterError


def load_yaml(path, node: str = '') -> dict:
    """The parameters in a ROS 2 params file as a flat dictionary of given names, unchecked.

    Reads the sections `/**` and, over it, `node` (with or without the slash); a file whose sections are all for
    other nodes raises ParameterError, since ROS would silently ignore it.
    """
    path = Path(path)
    try:
        document = yaml.safe_load(path.read_text())
    except OSError as error:
        raise ParameterError(f'params file {path}: {error.strerror}') from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ParameterError(f'params file {path} is not valid YAML: {" ".join(str(error).split())}') from None
    if not isinstance(document, dict):
        raise ParameterError(f'params file {path} holds no parameters')
    known = ['/**'] + ([node, f'/{node}'] if node else sorted(set(document) - {'/**'}))
    sections = [document[name] for name in known if name in document]
    if not sections:
        raise ParameterError(f"params file {path} has no section '/**' or '{node}', only {', '.join(document)}")
    values: dict = {}
    for section in sections:
        if not isinstance(section, dict) or not isinstance(section.get('ros__parameters'), dict):
            raise ParameterError(f"params file {path}: each node's parameters must stand under 'ros__parameters'")
        values.update(_flatten(section['ros__parameters']))
    return values


def _flatten(tree: dict, prefix: str = '') -> dict:
    flat: dict = {}
    for key, value in tree.items():
        if isinstance(value, dict):
            flat.update(_flatten(value, f'{prefix}{key}.'))
        else:
            flat[f'{prefix}{key}'] = value
    return flat


def yaml_value(value) -> str:
    """`value` as ROS reads it back in the same type: decimals keep their point."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(yaml_value(v) for v in value)}]"
    if isinstance(value, str):
        return f"'{value}'"
    text = repr(value)
    mantissa, exponent, power = text.partition('e')
    return text if not exponent or '.' in mantissa else f'{mantissa}.0e{power}'
