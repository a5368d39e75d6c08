"""YAML 1.2 scalars for files that people write: ``1e-3`` is a number, ``no`` is a text, keys stand once.

PyYAML follows YAML 1.1, where ``1e-3`` is a text and ``no`` is false.
"""

import re
from pathlib import Path
from typing import Any, Final

import yaml

from thalweg.core.errors import ConfigError

_TAG: Final = "tag:yaml.org,2002:"
_MOST_VALUES: Final = 20_000
"""No file of this kind is that large; a chain of aliases is."""


class Yaml12Loader(yaml.SafeLoader):
    """Safe loader with the scalars of the YAML 1.2 core schema."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - name and kind are PyYAML's


for _name, _pattern, _first in (
    ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", "tTfF"),
    ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("int", r"^[-+]?[0-9]+$", "-+0123456789"),
    ("float", r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$", "-+.0123456789"),
    ("float", r"^[-+]?\.(?:inf|Inf|INF)$|^\.(?:nan|NaN|NAN)$", "-+."),
):
    Yaml12Loader.add_implicit_resolver(_TAG + _name, re.compile(_pattern), list(_first))
# YAML 1.1 reads 010 as octal 8; here it is ten, as written.
Yaml12Loader.add_constructor(_TAG + "int", lambda _loader, node: int(node.value))


def read_mapping(path: Path) -> tuple[dict[str, Any], dict[tuple[str, ...], int]]:
    """Data of a YAML file that holds a mapping, and the line (from 1) of each key in it.

    Raises
    ------
    ConfigError : no such file, not UTF-8, not YAML, a key that stands twice, or no mapping.
    """
    try:
        loader = Yaml12Loader(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        reason = "no such file" if isinstance(error, FileNotFoundError) else (error.strerror or str(error))
        raise ConfigError(reason, where=path, expected="a YAML file", cure="Check the path") from error
    except UnicodeDecodeError as error:
        raise ConfigError("not a text in UTF-8", where=path, cure="Save the file as UTF-8") from error
    except yaml.YAMLError as error:
        raise ConfigError(f"not valid YAML: {error}", where=path, expected="printable text") from error
    lines: dict[tuple[str, ...], int] = {}
    try:
        node = loader.get_single_node()
        data = None if node is None else _construct(loader, node, (), lines, path)
    except yaml.MarkedYAMLError as error:
        line = f":{error.problem_mark.line + 1}" if error.problem_mark else ""
        raise ConfigError(
            f"not valid YAML: {error.problem or error}", where=f"{path}{line}",
            cure="Check indentation, colons (`key: value`) and brackets",
        ) from error  # fmt: skip
    except (yaml.YAMLError, RecursionError, ValueError) as error:
        raise ConfigError(f"not valid YAML: {error}", where=path, expected="plain YAML") from error
    finally:
        loader.dispose()
    if not isinstance(data, dict):
        raise ConfigError(
            "the file is empty" if data is None else f"the file holds a {type(data).__name__}",
            where=path, expected="keys with values, such as `title: My boat`",
        )  # fmt: skip
    return data, lines


def _construct(
    loader: Yaml12Loader,
    node: yaml.Node,
    path: tuple[str, ...],
    lines: dict[tuple[str, ...], int],
    file: Path,
) -> Any:
    lines.setdefault(path, node.start_mark.line + 1)
    if len(lines) > _MOST_VALUES:
        raise ValueError(f"more than {_MOST_VALUES:,} values, perhaps through aliases of aliases")
    if isinstance(node, yaml.SequenceNode):
        return [_construct(loader, item, (*path, str(i)), lines, file) for i, item in enumerate(node.value)]
    if not isinstance(node, yaml.MappingNode):
        return loader.construct_object(node)
    data: dict[str, Any] = {}
    for key_node, value_node in node.value:
        key, line = str(key_node.value), key_node.start_mark.line + 1
        if key in data:
            raise ConfigError(
                f"the key {'.'.join((*path, key))} stands twice, in lines {lines[(*path, key)]} and {line}",
                where=f"{file}:{line}", expected="each key once", cure="Remove one of them",
            )  # fmt: skip
        lines[(*path, key)] = line
        data[key] = _construct(loader, value_node, (*path, key), lines, file)
    return data
