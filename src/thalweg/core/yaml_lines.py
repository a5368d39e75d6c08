"""YAML that people write as plain data, with the line of each key; duplicate keys are refused.

Scalars follow the YAML 1.2 core schema: ``1e-3`` is a number, ``no`` and ``on`` are text, dates stay text.
(PyYAML's own YAML 1.1 reads ``1e-3`` as text and ``no`` as false.)
"""

import re
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from thalweg.core.errors import ConfigError
from thalweg.core.mistakes import Key, Mistake

MAX_VALUES = 100_000
"""No file of people is that large; a chain of aliases is."""


@dataclass(slots=True)
class Document:
    """Data of a YAML file, the line (from 1) of each path in it, and the mistakes met on the way."""

    data: Any = None
    lines: dict[tuple[Key, ...], int] = field(default_factory=dict)
    mistakes: list[Mistake] = field(default_factory=list)

    def line(self, path: tuple[Key, ...]) -> int:
        """Line of a path, or of the deepest part of it that stands in the file."""
        while path and path not in self.lines:
            path = path[:-1]
        return self.lines.get(path, 1)


class _Loader(yaml.SafeLoader):
    """Safe loader with the scalars of YAML 1.2."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - name and kind are PyYAML's


_TAG = "tag:yaml.org,2002:"
for _name, _pattern, _first in (
    ("bool", r"^(?:true|True|TRUE|false|False|FALSE)$", "tTfF"),
    ("null", r"^(?:~|null|Null|NULL|)$", ["~", "n", "N", ""]),
    ("int", r"^[-+]?[0-9]+$", "-+0123456789"),
    ("float", r"^[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?$", "-+.0123456789"),
    ("float", r"^[-+]?\.(?:inf|Inf|INF)$|^\.(?:nan|NaN|NAN)$", "-+."),
    ("merge", r"^<<$", "<"),
):
    _Loader.add_implicit_resolver(_TAG + _name, re.compile(_pattern), list(_first))
# YAML 1.1 reads 010 as octal 8; here it is ten, as written.
_Loader.add_constructor(_TAG + "int", lambda _loader, node: int(node.value))


def read_yaml(path: Path) -> Document:
    """Read a YAML file; what is wrong with it goes into ``mistakes``, next to the data that could be read."""
    try:
        text = path.read_text(encoding="utf-8-sig")
    except FileNotFoundError:
        return Document(mistakes=[Mistake(found="no such file", cure="Check the path")])
    except UnicodeDecodeError as error:
        line = path.read_bytes()[: error.start].count(b"\n") + 1
        mistake = Mistake(
            found=f"byte 0x{error.object[error.start]:02x} is not UTF-8",
            expected="a text file in UTF-8",
            cure="Save the file with the encoding UTF-8",
            line=line,
        )
        return Document(mistakes=[mistake])
    except OSError as error:
        found = "this is a folder" if path.is_dir() else f"cannot be read ({error.strerror})"
        return Document(mistakes=[Mistake(found=found, expected="a readable YAML file")])
    return parse_yaml(text)


def parse_yaml(text: str) -> Document:
    """Parse YAML text; see `read_yaml`."""
    document = Document()
    loader = None
    try:
        loader = _Loader(text)
        node = loader.get_single_node()
        if node is not None:
            document.data = _construct(loader, node, (), document)
    except yaml.YAMLError as error:
        document.mistakes.append(_syntax_mistake(error, text))
    except (ValueError, RecursionError) as error:
        document.mistakes.append(Mistake(found=f"a value cannot be read: {error}", expected="plain YAML"))
    finally:
        if loader is not None:
            loader.dispose()
    return document


def _construct(loader: _Loader, node: yaml.Node, path: tuple[Key, ...], document: Document) -> Any:
    document.lines.setdefault(path, node.start_mark.line + 1)
    if len(document.lines) > MAX_VALUES:
        raise ValueError(f"more than {MAX_VALUES:,} values, perhaps through aliases of aliases")
    if isinstance(node, yaml.SequenceNode):
        return [_construct(loader, item, (*path, i), document) for i, item in enumerate(node.value)]
    if not isinstance(node, yaml.MappingNode):
        return loader.construct_object(node)
    seen: dict[str, int] = {}
    for key_node, _ in node.value:
        line = key_node.start_mark.line + 1
        key = str(key_node.value)
        if key in seen:
            document.mistakes.append(
                Mistake(
                    path=(*path, key),
                    found=f"the key stands twice, in lines {seen[key]} and {line}",
                    expected="each key once",
                    cure="Remove one of them or join what stands below both",
                    line=line,
                )
            )
        seen.setdefault(key, line)
    loader.flatten_mapping(node)
    data: dict[str, Any] = {}
    for key_node, value_node in node.value:
        key = str(key_node.value)
        document.lines[(*path, key)] = key_node.start_mark.line + 1
        data[key] = _construct(loader, value_node, (*path, key), document)
    return data


def _syntax_mistake(error: yaml.YAMLError, text: str) -> Mistake:
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = str(getattr(error, "problem", None) or error).splitlines()[0]
    if mark is None:
        position = getattr(error, "position", None)
        line = text[:position].count("\n") + 1 if isinstance(position, int) else 0
        found = "a control character" if position is not None else problem
        return Mistake(
            found=f"not valid YAML: {found}",
            line=line,
            expected="printable text",
            cure="Remove the character",
        )
    line = mark.line + 1
    rows = text.splitlines()
    row = rows[mark.line] if mark.line < len(rows) else ""
    return Mistake(
        found=f"not valid YAML: {problem}", line=line, expected="plain YAML", cure=_syntax_cure(problem, row)
    )


def _syntax_cure(problem: str, row: str) -> str:
    if "\t" in row:
        return "Replace the tab by spaces: YAML indents with spaces only"
    if "mapping values are not allowed" in problem:
        return "Put text that holds a colon in quotes, and indent keys of one section equally"
    if "undefined alias" in problem or "could not determine a constructor" in problem:
        return "Put text that begins with *, & or ! in quotes"
    if "but found another document" in problem or "expected a single document" in problem:
        return "Keep one document in one file: remove the line ---"
    if "expected ',' or" in problem or "found unexpected end of stream" in problem:
        return "Close the bracket or quote that this line or one before it opens"
    if "cannot start any token" in problem:
        return "Put text that begins with @, ` or % in quotes"
    return "Check indentation (spaces, equal within a section), colons (`key: value`) and brackets"


def read_mapping(path: Path) -> tuple[dict[str, Any], dict[tuple[str, ...], int]]:
    """Data of a YAML file that holds a mapping, and the line (from 1) of each key in it.

    Raises
    ------
    ConfigError : the first of what `read_yaml` finds wrong, or the file holds no mapping.
    """
    document = read_yaml(path)
    for mistake in document.mistakes:
        where = f"{path}:{mistake.line}" if mistake.line else path
        found = f"{mistake.dotted}: {mistake.found}" if mistake.path else mistake.found
        raise ConfigError(found, where=where, expected=mistake.expected, cure=mistake.cure)
    if not isinstance(document.data, dict):
        raise ConfigError(
            "the file is empty"
            if document.data is None
            else f"the file holds a {type(document.data).__name__}",
            where=path,
            expected="keys with values, such as `title: My boat`",
        )
    return document.data, {tuple(str(key) for key in keys): line for keys, line in document.lines.items()}
