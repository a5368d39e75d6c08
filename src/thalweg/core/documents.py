"""Documents in YAML: every value with its line, all mistakes of a file at once; XML and pictures, with care.

All mistakes are told at once, each with its line, what was found, what was expected, what to do. The first
field of a model names the kind and the version of the document, as ``thalweg_field: Literal[1]``.
"""

import difflib
import json
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeVar, get_args
from xml.etree import ElementTree

import yaml
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, ValidationError, model_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from thalweg.core.errors import ConfigError, InputError
from thalweg.core.installed import optional

if TYPE_CHECKING:
    from thalweg.core.types import AnyArray, ArrayU8

cv2 = optional("cv2")

# ---------------------------------------------------------------- files being written, files of others

UNFINISHED: Final = ".part-"
"""Start of the name of a folder with outputs of a running job, inside the folder where they will stand."""


def final_path(path: Path) -> Path:
    """Where a file will stand when its job is done; links from it to other files start there.

    Examples
    --------
    >>> final_path(Path("results/tiny/.part-0a1b/index.html")).as_posix()
    'results/tiny/index.html'
    """
    return Path(*(part for part in path.parts if not part.startswith(UNFINISHED)))


_AGAIN: Final = "Copy the file again, or export it again from the program that wrote it"


_MOST_DIGITS: Final = 300
"""Of a whole number: a longer one is beyond what a float can hold."""


class _Builder(ElementTree.TreeBuilder):
    """Builds trees of documents that declare no types: entities could read files, or grow without bound."""

    def doctype(self, name: str, public: str | None, system: str | None) -> None:
        """The parser calls this before any entity is declared."""
        raise ElementTree.ParseError(f"it declares a document type ({name}), which no survey program writes")


def parse_xml(text: str | bytes, where: str | Path, expected: str = "XML") -> ElementTree.Element:
    """Root of an XML document.

    Parameters
    ----------
    where : its file.
    expected : what the document should be.

    Raises
    ------
    InputError : no XML, or one with a document type and so perhaps entities.
    """
    parser = ElementTree.XMLParser(target=_Builder())
    try:
        parser.feed(text)
        root = parser.close()
    except (ElementTree.ParseError, ValueError, LookupError) as error:  # the last two: of an encoding
        raise InputError(f"no XML ({error})", expected=expected, where=where, cure=_AGAIN) from error
    if not isinstance(root, ElementTree.Element):
        raise InputError("no XML (no element found)", expected=expected, where=where, cure=_AGAIN)
    return root


def _whole(digits: str) -> int:
    """A whole number, if whatever works with numbers can take it."""
    if len(digits) > _MOST_DIGITS:
        raise ValueError(f"a number of {len(digits)} digits")
    return int(digits)


def parse_json(text: str | bytes, where: str | Path, expected: str = "JSON", cure: str = _AGAIN) -> Any:
    """What a text in JSON holds.

    Parameters
    ----------
    where : its file.
    expected : what the text should be.
    cure : how to get a whole one.

    Raises
    ------
    InputError : no JSON, not in UTF-8, or lists in lists without end.
    """
    try:
        return json.loads(text, parse_int=_whole)
    except (ValueError, RecursionError) as error:
        raise InputError(f"no JSON ({error})", expected=expected, where=where, cure=cure) from error


def read_json(path: Path, expected: str = "JSON", cure: str = _AGAIN) -> Any:
    """What a file in JSON holds; see `parse_json`.

    Raises
    ------
    InputError : no such file, or no JSON.
    """
    if not path.is_file():
        raise InputError("file not found", expected=expected, where=path, cure=cure)
    return parse_json(path.read_bytes().removeprefix(b"\xef\xbb\xbf"), path, expected, cure)


def write_json(path: Path, facts: Any) -> None:
    """Facts as a file in JSON, for people too."""
    path.write_text(json.dumps(facts, indent=2) + "\n", encoding="utf-8")


def decode_picture(data: "ArrayU8", flags: int) -> "AnyArray | None":
    """Pixels of a stored picture, as ``cv2.imdecode`` gives them; None if it is none.

    Neither is one whose head promises more than 2 ** 30 pixels: some kilobytes can stand for them.
    """
    import numpy as np

    try:
        picture = cv2.imdecode(data, flags) if data.size else None
    except cv2.error:
        return None
    return None if picture is None else np.asarray(picture)


# ---------------------------------------------------------------- documents in YAML

Name = Annotated[str, Field(min_length=1)]
"""A text that is not empty."""
Text = Annotated[str, AfterValidator(lambda text: " ".join(text.split())), Field(min_length=1)]
"""A text in one line that is not empty, wherever the file breaks it."""
_KINDS = {
    "float_type": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "string_type": "a text",
    "string_too_short": "a text",
    "model_type": "keys with values",
    "dict_type": "keys with values",
    "list_type": "a list, each entry with a dash",
    "too_short": "at least one entry",
}

MAX_VALUES = 100_000
"""No file of people is that large; a chain of aliases is."""
_TAG = "tag:yaml.org,2002:"
Key = str | int
"""A key of a mapping, or an index into a list."""
Node = dict[str, Any]
"""A part of a JSON schema."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Mistake:
    """One mistake: where it stands, what was found, what was expected, what to do."""

    path: tuple[Key, ...] = ()
    found: str
    expected: str = ""
    cure: str = ""
    line: int = 0
    """Line in the file, from 1; 0 if unknown."""
    file: Path | None = field(default=None)

    @property
    def dotted(self) -> str:
        """Path in the file, for instance ``logs.lidar[1]``."""
        text = ""
        for key in self.path:
            text += f"[{key}]" if isinstance(key, int) else (f".{key}" if text else str(key))
        return text

    def __str__(self) -> str:
        where = str(self.file) if self.file else ""
        if self.line:
            where += f":{self.line}" if where else f"line {self.line}"
        parts = [p for p in (where, self.dotted) if p]
        text = ": ".join([*parts, self.found])
        if self.expected:
            text += f"; expected {self.expected}"
        text += "."
        if self.cure:
            cure = self.cure.rstrip(".")
            text += f" {cure}" if cure.endswith("?") else f" {cure}."
        return text


@dataclass(slots=True)
class Document:
    """Data of a YAML file, the line (from 1) of each path in it, and the mistakes met on the way."""

    data: Any = None
    lines: dict[tuple[Key, ...], int] = field(default_factory=dict)
    mistakes: list[Mistake] = field(default_factory=list)
    files: dict[tuple[Key, ...], Path] = field(default_factory=dict)
    """File of each path, where a document is put together of several."""

    def line(self, path: tuple[Key, ...]) -> int:
        """Line of a path, or of the deepest part of it that stands in the file."""
        return self.lines.get(self._known(path), 1)

    def mistake(self, path: tuple[Key, ...], found: str, expected: str = "", cure: str = "") -> Mistake:
        """A mistake at a path, with its line."""
        file = self.files.get(self._known(path))
        return Mistake(path=path, found=found, expected=expected, cure=cure, line=self.line(path), file=file)

    def _known(self, path: tuple[Key, ...]) -> tuple[Key, ...]:
        while path and path not in self.lines:
            path = path[:-1]
        return path


# ---------------------------------------------------------------- models


class Part(BaseModel):
    """A part of a document with known keys: others are refused, values never change after reading.

    A key without a value is as if it did not stand there.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    @model_validator(mode="before")
    @classmethod
    def _given(cls, data: Any) -> Any:
        return {k: v for k, v in data.items() if v is not None} if isinstance(data, dict) else data


PartT = TypeVar("PartT", bound=Part)


def wrong(found: str, expected: str, cure: str = "", at: tuple[Key, ...] = ()) -> PydanticCustomError:
    """What a validator raises: a mistake at a path below the value that it checks."""
    return PydanticCustomError(
        "wrong", "{found}", {"found": found, "expected": expected, "cure": cure, "at": at}
    )


def refuse(mistakes: Sequence[PydanticCustomError]) -> None:
    """Raise what `wrong` gives, several mistakes as one error; nothing if there is none."""
    if mistakes:
        raise PydanticCustomError("several", "several", {"all": [dict(m.context or {}) for m in mistakes]})


def one_of(choice: Sequence[str]) -> AfterValidator:
    """For texts: one of a few."""

    def check(value: str) -> str:
        """The text itself, if it is allowed."""
        if value not in choice:
            raise wrong(f"found {value!r}", f"one of: {'; '.join(choice)}")
        return value

    return AfterValidator(check)


_MEANT: Final = {
    ("gps", "rtk", "receiver"): ("gnss", "positions", "antenna"),
    ("gnss",): ("positions", "antenna"),
    ("imu", "ahrs", "gyro"): ("ins",),
    ("sonar", "sounder", "echosounder", "multibeam"): ("echo_sounder", "depth"),
    ("scanner", "laser", "laserscanner", "pcap", "velodyne"): ("lidar",),
    ("photos", "photographs", "pictures", "camera", "cameras"): ("images", "time_lapse", "camera"),
    ("trajectory", "ppk", "pospac"): ("sbet",),
    ("epsg", "projection", "coordinates", "utm"): ("crs",),
    ("lever_arms", "offsets", "boresight"): ("mounts",),
    ("name",): ("id",),
}
"""Names that people use, and those here that may mean the same, the likelier first."""


def did_you_mean(name: str, names: Iterable[str]) -> str:
    """Cure for a name that is not known: one of the same meaning, else the most similar; empty if none is.

    Examples
    --------
    >>> (
    ...     did_you_mean("gps", ["ins", "gnss"]),
    ...     did_you_mean("lidra", ["lidar", "ins"]),
    ...     did_you_mean("x", ["a"]),
    ... )
    ('Did you mean gnss?', 'Did you mean lidar?', '')
    """
    known, word = list(names), str(name).lower()
    meant = [each for words, same in _MEANT.items() if word in words for each in same if each in known]
    found = meant or difflib.get_close_matches(str(name), known)
    return f"Did you mean {found[0]}?" if found else ""


def checked(
    model: type[PartT],
    document: Document,
    *,
    what: str,
    where: Path | None = None,
    context: Mapping[str, Any] | None = None,
    cure: str = "",
) -> PartT:
    """A document as its model.

    Parameters
    ----------
    model : of the whole document; its first field is the mark that the document begins with. Lists are
        `list`: no list is taken for a tuple.
    document : data and lines, from `read_yaml` or `parse_yaml`.
    what : what the document is, as ``description of the field``.
    where : its file.
    context : for the model's validators.
    cure : where to read on.

    Raises
    ------
    ConfigError : lists every mistake with its line.
    """
    found, mistakes = validated(model, document, what=what, context=context)
    if found is not None:
        return found
    n = len(mistakes)
    head = f"{n} mistake{'s' if n > 1 else ''} in the {what}"
    text = head + "".join(f"\n  {mistake}" for mistake in mistakes)
    raise ConfigError(text.rstrip("."), where=where or "", cure=cure)


def validated(
    model: type[PartT], document: Document, *, what: str, context: Mapping[str, Any] | None = None
) -> tuple[PartT | None, list[Mistake]]:
    """A document as its model, or None and all mistakes by line; parameters as of `checked`."""
    mistakes = list(document.mistakes)
    if isinstance(document.data, dict):
        try:
            # strict: no text for numbers, no number for true
            found = model.model_validate(document.data, strict=True, context=dict(context or {}))
            if not mistakes:
                return found, []
        except ValidationError as error:
            schema = Schema(model)
            for detail in error.errors(include_url=False):
                mistakes += _mistakes(detail, schema, document)
    elif not mistakes:
        mark, field = next(iter(model.model_fields.items()))
        versions = get_args(field.annotation)
        expected = f"a {what} that begins with {mark}: {versions[0]}" if versions else f"keys of the {what}"
        found_kind = "nothing stands here" if document.data is None else "no keys with values"
        mistakes.append(document.mistake((), found_kind, expected))
    return None, sorted(mistakes, key=lambda mistake: mistake.line)


class Schema:
    """What may stand where in the documents of a model: look-ups in its JSON schema.

    Parameters
    ----------
    model : of whole documents.
    """

    def __init__(self, model: type[BaseModel]) -> None:
        self._model = model

    @cached_property
    def whole(self) -> Node:
        """The JSON schema."""
        return self._model.model_json_schema()

    def resolve(self, node: Node) -> Node:
        """A node with its reference followed, and the non-null part of an optional value."""
        for _ in range(8):
            if "$ref" in node:
                rest = {k: v for k, v in node.items() if k != "$ref"}
                node = {**self.whole["$defs"][node["$ref"].rsplit("/", 1)[1]], **rest}
                continue
            options = node.get("anyOf") or node.get("allOf") or []
            real = [o for o in options if o.get("type") != "null" and "required" not in o]
            if "properties" in node or not real:
                return node
            node = {**{k: v for k, v in node.items() if k not in {"anyOf", "allOf"}}, **real[0]}
        return node

    def at(self, path: tuple[Key, ...]) -> Node:
        """Node of a path; empty if the path is not part of the schema."""
        node = self.resolve(self.whole)
        for key in path:
            if isinstance(key, int):
                items = node.get("prefixItems", [])
                child = items[key] if key < len(items) else node.get("items", {})
            else:
                # what stands below a name that the user chooses, such as that of a scan, if any may
                free = (
                    v for pattern, v in node.get("patternProperties", {}).items() if re.search(pattern, key)
                )
                other = next(free, node.get("additionalProperties"))
                child = node.get("properties", {}).get(key) or other
            node = self.resolve(child) if isinstance(child, dict) else {}
        return node

    def keys(self, path: tuple[Key, ...]) -> list[str]:
        """Keys that are allowed below a path."""
        return list(self.at(path).get("properties", {}))


def number_in_words(node: Node) -> str:
    """A number and its limits, as the schema states them."""
    text = "a whole number" if node.get("type") == "integer" else "a number"
    low, high = node.get("minimum"), node.get("maximum")
    above, below = node.get("exclusiveMinimum"), node.get("exclusiveMaximum")
    if low is not None and high is not None:
        return f"{text} from {_plain(low)} to {_plain(high)}"
    text += f" of at least {_plain(low)}" if low is not None else ""
    text += f" above {_plain(above)}" if above is not None else ""
    text += f" up to {_plain(high)}" if high is not None else ""
    return text + (f" below {_plain(below)}" if below is not None else "")


def _plain(value: float) -> str:
    return str(value) if isinstance(value, int) or not float(value).is_integer() else str(int(value))


def _mistakes(detail: ErrorDetails, schema: Schema, document: Document) -> list[Mistake]:
    """One finding of pydantic."""
    # a key that is refused is called [key] below its value's place
    path: tuple[Key, ...] = tuple(key for key in detail["loc"] if key != "[key]")
    kind, value, context = detail["type"], detail["input"], detail.get("ctx", {})
    found = f"found keys {', '.join(map(str, value))}" if isinstance(value, Mapping) else f"found {value!r}"
    cure = ""
    described = _described(schema, path)
    if kind in ("wrong", "several"):
        return [
            document.mistake((*path, *one["at"]), one["found"], one["expected"], one["cure"])
            for one in context.get("all", [context])
        ]
    if kind == "extra_forbidden":
        keys = schema.keys(path[:-1])
        found, expected, cure = "unknown key", f"one of {', '.join(keys)}", did_you_mean(str(path[-1]), keys)
    elif kind == "missing":
        found, expected = f"{path[-1]} is missing", described or f"the key {path[-1]}"
        path = path if path in document.lines else path[:-1]
    elif kind == "literal_error":
        expected = described or str(context["expected"]).replace("'", "")
    else:
        expected = described or _KINDS.get(kind) or detail["msg"].removeprefix("Input should be ")
    if value is None and kind != "missing":
        found = "nothing stands here"
    return [document.mistake(path, found, expected, cure)]


def _described(schema: Schema, path: tuple[Key, ...]) -> str:
    """What a field's description says, else its limits; empty for others."""
    while path and path[-1] not in schema.keys(path[:-1]):  # an entry of a list, or below a name of the file
        path = path[:-1]
    field = schema.at(path[:-1])["properties"][path[-1]] if path else {}
    if "description" in field:
        return str(field["description"])
    node = schema.resolve(field)
    return number_in_words(node) if _LIMITS & node.keys() else ""


_LIMITS: Final = {"minimum", "maximum", "exclusiveMinimum", "exclusiveMaximum"}

# ---------------------------------------------------------------- lines of the values
#
# Scalars follow the YAML 1.2 core schema: ``1e-3`` is a number, ``no`` and ``on`` are text, dates stay text.
# (PyYAML's own YAML 1.1 reads ``1e-3`` as text and ``no`` as false.)


# ---------------------------------------------------------------- YAML


class _Loader(yaml.SafeLoader):
    """Safe loader with the scalars of YAML 1.2, in Python: its words on what is wrong are better."""

    yaml_implicit_resolvers: dict[str, Any] = {}  # noqa: RUF012 - name and kind are PyYAML's


class _QuickLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
    """The same by libyaml, where PyYAML was built with it: a tenth of the time."""

    yaml_implicit_resolvers = _Loader.yaml_implicit_resolvers


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
for _kind in (_Loader, _QuickLoader):
    _kind.add_constructor(_TAG + "int", lambda _loader, node: _whole(node.value))


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
    """Parse YAML text; see `read_yaml`. OpenCV's head, as OpenVINS has it, is that of no YAML version."""
    text = re.sub(r"\A%YAML:", "#YAML:", text)
    # libyaml lets tabs pass that Python's parser refuses with its line and cure
    document = _parsed(text, _Loader if "\t" in text else _QuickLoader)
    return _parsed(text, _Loader) if document.mistakes else document


def _parsed(text: str, kind: type[_Loader | _QuickLoader]) -> Document:
    document = Document()
    loader = None
    try:
        loader = kind(text)
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


def _construct(
    loader: _Loader | _QuickLoader, node: yaml.Node, path: tuple[Key, ...], document: Document
) -> Any:
    document.lines.setdefault(path, node.start_mark.line + 1)
    if len(document.lines) > MAX_VALUES:
        raise ValueError(f"more than {MAX_VALUES:,} values, perhaps through aliases of aliases")
    if isinstance(node, yaml.SequenceNode):
        return [_construct(loader, item, (*path, i), document) for i, item in enumerate(node.value)]
    if not isinstance(node, yaml.MappingNode):
        try:
            return loader.construct_object(node)
        except (LookupError, ArithmeticError, TypeError, AttributeError):
            kind = node.tag.removeprefix(_TAG)
            raise ValueError(f"line {node.start_mark.line + 1} calls {node.value!r} {kind}") from None
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
    if _n_keys(node, {}) > MAX_VALUES:
        raise ValueError(f"more than {MAX_VALUES:,} values, through merges (<<) of merges")
    loader.flatten_mapping(node)
    data: dict[str, Any] = {}
    for key_node, value_node in node.value:
        key = str(key_node.value)
        document.lines[(*path, key)] = key_node.start_mark.line + 1
        data[key] = _construct(loader, value_node, (*path, key), document)
    return data


def _n_keys(node: yaml.Node, known: dict[yaml.Node, int]) -> int:
    """Keys of a mapping, or of a list of mappings, when all that they merge (``<<``) is copied into them."""
    if node not in known:
        match node:
            case yaml.MappingNode():
                n = sum(_n_keys(v, known) if k.tag == _TAG + "merge" else 1 for k, v in node.value)
            case yaml.SequenceNode():
                n = sum(_n_keys(each, known) for each in node.value)
            case _:
                n = 0
        known[node] = n
    return known[node]


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
