"""The version of the code behind a rule: a hash of every module that its entry script reaches.

Snakemake sees edits of an entry script but not of a package that the script imports. Each rule therefore
carries ``params: code=code_version("<script>")``. The hash runs over the syntax trees, without docstrings,
of the modules that the script imports directly or through others; a comment costs no rerun, an edit of a
module reruns exactly the rules that use it, and no list of rooms has to be kept by hand.
"""

import ast
import hashlib
from functools import cache
from pathlib import Path

from thalweg.core.errors import InputError

PACKAGE_ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = PACKAGE_ROOT.parents[1] / "workflow" / "scripts"

DATA_SUFFIXES = {".mplstyle", ".csv", ".yaml", ".json"}
"""Files inside the package that count as code."""

_DIGITS = 12


def code_version(script: str, *, scripts: Path = SCRIPTS, package_root: Path = PACKAGE_ROOT) -> str:
    """Hash of the modules of the package that an entry script reaches.

    Parameters
    ----------
    script : name of the entry script without ``.py``.
    scripts : folder of entry scripts.
    package_root : folder of the package.

    Raises
    ------
    InputError : there is no such script, or a file is not valid Python.

    Examples
    --------
    >>> len(code_version("georeference_lidar"))
    12
    """
    path = scripts / f"{script}.py"
    if not path.is_file():
        raise InputError("entry script not found", where=path, expected="one script for each rule")
    digest = hashlib.sha256()
    for module in sorted(reached_modules(path, package_root)):
        digest.update(module.relative_to(package_root).as_posix().encode())
        digest.update(_tree_hash(module))
        if module.name == "__init__.py":
            # what is no module but shapes results, such as the style of the figures
            for data in sorted(p for p in module.parent.iterdir() if p.suffix in DATA_SUFFIXES):
                digest.update(data.name.encode() + data.read_bytes())
    return digest.hexdigest()[:_DIGITS]


def reached_modules(path: Path, package_root: Path = PACKAGE_ROOT) -> set[Path]:
    """All modules of the package that a file imports, directly or through others, lazily or at its head."""
    seen: set[Path] = set()
    queue = [path]
    while queue:
        for module in _imports(queue.pop(), package_root):
            if module not in seen:
                seen.add(module)
                queue.append(module)
    return seen


@cache
def _parse(path: Path) -> ast.Module:
    try:
        return ast.parse(path.read_text(encoding="utf-8"))
    except SyntaxError as error:
        raise InputError(f"not valid Python: {error}", where=path) from error


@cache
def _imports(path: Path, package_root: Path) -> frozenset[Path]:
    names: set[str] = set()
    for node in ast.walk(_parse(path)):
        if isinstance(node, ast.Import):
            names.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            names.add(node.module)
            names.update(f"{node.module}.{alias.name}" for alias in node.names)
    found: set[Path] = set()
    for name in names:
        first, *rest = name.split(".")
        if first != package_root.name:
            continue
        base = package_root
        for part in ["", *rest]:
            base = base / part if part else base
            if (base / "__init__.py").is_file():
                found.add(base / "__init__.py")
            elif base.with_suffix(".py").is_file():
                found.add(base.with_suffix(".py"))
    return frozenset(found)


@cache
def _tree_hash(path: Path) -> bytes:
    tree = _parse(path)
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            body = node.body
            if body and isinstance(body[0], ast.Expr) and isinstance(body[0].value, ast.Constant):
                node.body = body[1:]
    return hashlib.sha256(ast.dump(tree).encode()).digest()
