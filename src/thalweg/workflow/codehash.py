"""The version of the code behind a rule: a hash of every module that its entry script reaches.

Snakemake sees edits of an entry script but not of packages that the script imports. Each rule therefore
carries ``params: code=code_version("<script>")``. The hash runs over the syntax trees, without docstrings
and types that only readers need, of the modules that the script imports directly or through others; a comment
costs no rerun, an edit of a module reruns exactly the rules that use it, and no list of packages has to be
kept by hand. A name that is imported from the front door of a package (``__init__.pyi``) counts as its
module; an edit beside it costs nothing.

What a file imports and the hash of its tree depend on its bytes alone. Both are kept in the user's cache by
the hash of these bytes, because parsing some hundred modules takes seconds at each start of Snakemake.
"""

import ast
import atexit
import hashlib
import json
import logging
import os
import sys
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from thalweg.core import PACKAGES, ROOT, InputError

SOURCE = Path(__file__).resolve().parents[2]
"""Folder of the packages: library and laboratory."""
SCRIPTS = ROOT / "workflow" / "scripts"

DATA_SUFFIXES = {".mplstyle", ".typ", ".csv", ".yaml", ".json", ".html", ".css", ".js"}
"""Files inside a package that count as code."""

_DIGITS = 12


def code_version(
    script: str, called: str | None = None, *, scripts: Path = SCRIPTS, source: Path = SOURCE
) -> str:
    """Hash of the modules that an entry script reaches.

    Parameters
    ----------
    script : name of the entry script without ``.py``.
    called : ``module:function`` that the script calls by name, without an import that could be seen in it.
    scripts : folder of entry scripts.
    source : folder of the packages.

    Raises
    ------
    InputError : there is no such script or module, or a file is not valid Python.

    Examples
    --------
    >>> len(code_version("georeference_lidar"))
    12
    """
    path = scripts / f"{script}.py"
    if not path.is_file():
        raise InputError("entry script not found", where=path, expected="one script for each rule")
    digest = hashlib.sha256()
    reached = reached_modules(path, source)
    if called is not None:
        reached |= modules_behind(called.split(":", maxsplit=1)[0], source)
    for module in sorted(reached):
        digest.update(module.relative_to(source).as_posix().encode())
        digest.update(_tree_hash(module))
        if module.name == "__init__.py":
            digest.update(_data_of(module.parent))
    return digest.hexdigest()[:_DIGITS]


def reached_modules(path: Path, source: Path = SOURCE) -> set[Path]:
    """All modules of ``source`` that a file imports, directly or through others, lazily or at its head."""
    return _closure([path], source)


def modules_behind(name: str, source: Path = SOURCE) -> set[Path]:
    """A module, the packages that hold it, and all modules of ``source`` that they reach.

    Raises
    ------
    InputError : there is no such module.
    """
    own = _files_of(name, source)
    if not any(path.name != "__init__.py" for path in own):
        raise InputError(f"no module {name}", where=source, expected="a module of the library")
    return _closure(sorted(own), source) | own


def _closure(queue: list[Path], source: Path) -> set[Path]:
    seen: set[Path] = set()
    while queue:
        for module in _imports(queue.pop(), source):
            if module not in seen:
                seen.add(module)
                queue.append(module)
    return seen


def imported_modules(path: Path, source: Path = SOURCE) -> set[Path]:
    """The modules of ``source`` that a file imports itself, lazily or at its head."""
    return set(_imports(path, source))


@dataclass(frozen=True, slots=True)
class _Facts:
    """What of a file counts: the names that it imports, and the hash of its tree without docstrings."""

    names: tuple[str, ...]
    tree: str


@cache
def _imports(path: Path, source: Path) -> frozenset[Path]:
    return frozenset(found for name in _facts(path).names for found in _files_of(name, source))


def _files_of(name: str, source: Path) -> frozenset[Path]:
    """Files of a dotted name: of each package on the way, and of the module."""
    return _way(name, source)[1]


@cache
def _way(name: str, source: Path) -> tuple[Path, frozenset[Path]]:
    """Folder that a dotted name would be, and the files on the way to it."""
    if source == SOURCE and name.partition(".")[0] not in PACKAGES:  # beside it where a wheel is installed
        return source / "none", frozenset()
    above, _, part = name.rpartition(".")
    base, found = _way(above, source) if above else (source, frozenset())
    base = base / part
    if (door := base / "__init__.py").is_file():
        found |= {door}
    elif part in (names := _door(base.parent)):
        found |= {names[part]}
    elif (module := base.with_suffix(".py")).is_file():
        found |= {module}
    return base, found


@cache
def _door(package: Path) -> dict[str, Path]:
    """Names that a package exports, with the modules that define them."""
    stub = package / "__init__.pyi"
    if not stub.is_file():
        return {}
    statements = [node for node in ast.parse(stub.read_bytes()).body if isinstance(node, ast.ImportFrom)]
    return {
        alias.name: package.joinpath(*(node.module or alias.name).split(".")).with_suffix(".py")
        for node in statements
        for alias in node.names
    }


@cache
def _data_of(package: Path) -> bytes:
    """What is no module but shapes results, such as the style of the figures: names and contents."""
    files = sorted(path for path in package.iterdir() if path.suffix in DATA_SUFFIXES)
    return b"".join(path.name.encode() + path.read_bytes() for path in files)


def _tree_hash(path: Path) -> bytes:
    return bytes.fromhex(_facts(path).tree)


@cache
def _facts(path: Path) -> _Facts:
    data = path.read_bytes()
    key = hashlib.sha256(data).hexdigest()
    kept = _kept().get(key)
    if kept is None:
        kept = _parsed(path, data)
        _kept()[key] = kept
        _new.add(key)
    return kept


class _Runs(ast.NodeTransformer):
    """Leaves of a tree what runs: no docstrings, none of names either, and no types that only readers need.

    Fields of classes keep their types, and so do parameters of public functions: documents and jobs are
    read by them.
    """

    _in_class = False

    def visit_Expr(self, node: ast.Expr) -> ast.AST | None:
        """Without constants that stand alone: docstrings."""
        return None if isinstance(node.value, ast.Constant) else self.generic_visit(node)

    def visit_If(self, node: ast.If) -> ast.AST | None:
        """Without imports for types alone."""
        types_only = isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
        return None if types_only else self.generic_visit(node)

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.AST:
        """With the annotations of its fields: documents are converted by them."""
        around, self._in_class = self._in_class, True
        self.generic_visit(node)
        self._in_class = around
        return node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.AST:
        """With the annotations of parameters of public functions only: jobs convert by them."""
        node.returns = None
        if self._in_class or node.name.startswith("_"):
            for each in ast.walk(node.args):
                if isinstance(each, ast.arg):
                    each.annotation = None
        around, self._in_class = self._in_class, False
        self.generic_visit(node)
        self._in_class = around
        return node

    def visit_AnnAssign(self, node: ast.AnnAssign) -> ast.AST | None:
        """Without the annotation, outside classes."""
        if self._in_class:
            return node
        return None if node.value is None else ast.Assign([node.target], node.value)


def _parsed(path: Path, data: bytes) -> _Facts:
    try:
        tree = ast.parse(data)
    except (SyntaxError, ValueError) as error:
        raise InputError(f"not valid Python: {error}", where=path) from error
    tree = _Runs().visit(tree)
    names: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    return _Facts(tuple(sorted(names)), hashlib.sha256(ast.dump(tree).encode()).hexdigest())


# ---------------------------------------------------------------- cache

_MOST_KEPT = 20_000
"""Entries of 300 bytes; beyond, old versions of files are forgotten."""
_new: set[str] = set()


def _cache_file() -> Path:
    """Where facts are kept; another Python, or another version of this module, has another file."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    own = hashlib.sha256(Path(__file__).read_bytes()).hexdigest()[:_DIGITS]
    return base / "thalweg" / f"code-{sys.version_info.major}.{sys.version_info.minor}-{own}.json"


@cache
def _kept() -> dict[str, _Facts]:
    """Facts of earlier starts; none if there are none, or the file is damaged."""
    atexit.register(_keep)
    try:
        found = json.loads(_cache_file().read_text(encoding="utf-8"))
        return {key: _Facts(tuple(names), tree) for key, (names, tree) in found.items()}
    except (OSError, RuntimeError, ValueError, TypeError, AttributeError):
        return {}


def _keep() -> None:
    """Write the facts whole or not at all; a cache that cannot be written costs time, nothing else."""
    if not _new:
        return
    facts = _kept() if len(_kept()) <= _MOST_KEPT else {key: _kept()[key] for key in _new}
    try:
        target = _cache_file()
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile("w", dir=target.parent, delete=False, encoding="utf-8") as file:
            json.dump({key: (each.names, each.tree) for key, each in facts.items()}, file)
        Path(file.name).replace(target)
    except (OSError, RuntimeError) as error:
        logging.getLogger("thalweg").debug("code versions are not kept for the next start: %s", error)
