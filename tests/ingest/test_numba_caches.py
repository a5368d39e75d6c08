"""Compiled code that numba keeps on disk depends on its own module only.

The cache of a kernel is renewed when its own file changes. Constants and kernels of another module are frozen
into the machine code: after an edit there the old values would go on being used without a word.
"""

import ast
import builtins
from collections.abc import Iterator
from pathlib import Path

import pytest

LIBRARIES = {"numpy", "numba", "math"}
"""Modules outside of the project whose names a kernel may use: their version is part of the environment."""


def is_cached(node: ast.FunctionDef) -> bool:
    return any(
        isinstance(d, ast.Call)
        and any(
            k.arg == "cache" and not (isinstance(k.value, ast.Constant) and k.value.value is False)
            for k in d.keywords
        )
        for d in node.decorator_list
        if ast.unparse(d).split("(")[0].split(".")[-1] in {"njit", "jit", "vectorize", "guvectorize"}
    )


def imported(tree: ast.Module) -> dict[str, str]:
    """Name -> module from which it is imported, for all imports that are not of the libraries."""
    found: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            module = "." * node.level + (node.module or "")
            found |= {a.asname or a.name: module for a in node.names}
        elif isinstance(node, ast.Import):
            found |= {a.asname or a.name.split(".")[0]: a.name for a in node.names}
    return {n: m for n, m in found.items() if m.split(".")[0] not in LIBRARIES}


def body_names(function: ast.FunctionDef) -> set[str]:
    """Names read in the body; annotations and decorators are no part of the machine code."""
    stack: list[ast.AST] = [*function.body, *function.args.defaults]
    found = set()
    while stack:
        node = stack.pop()
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Load):
            found.add(node.id)
        if isinstance(node, ast.AnnAssign):
            stack += [n for n in (node.target, node.value) if n is not None]
        else:
            stack += ast.iter_child_nodes(node)
    return found


def foreign_names(source: str) -> Iterator[str]:
    """Names that cached kernels take from other modules, also by way of constants of their own module.

    A constant ``A = B + 1`` of an imported ``B``, or a function used by the kernel, hands the dependence on.
    """
    tree = ast.parse(source)
    outside = imported(tree)
    depends: dict[str, set[str]] = {}
    for node in tree.body:
        match node:
            case ast.FunctionDef():
                depends[node.name] = body_names(node)
            case ast.Assign() | ast.AnnAssign() if node.value is not None:
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                read = {n.id for n in ast.walk(node.value) if isinstance(n, ast.Name)}
                for target in targets:
                    for name in ast.walk(target):
                        if isinstance(name, ast.Name):
                            depends[name.id] = read
    for node in tree.body:
        if not (isinstance(node, ast.FunctionDef) and is_cached(node)):
            continue
        own = {a.arg for a in ast.walk(node.args) if isinstance(a, ast.arg)}
        own |= {n.id for n in ast.walk(node) if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)}
        todo, seen = list(body_names(node) - own), set(own)
        while todo:
            name = todo.pop()
            if name in seen or hasattr(builtins, name):
                continue
            seen.add(name)
            if name in outside:
                yield f"{node.name} uses {name} of {outside[name]}"
            todo += depends.get(name, ())


def test_cached_kernels_use_names_of_their_own_module_only(repository: Path) -> None:
    package = repository / "src" / "thalweg"
    n_kernels, found = 0, []
    for path in sorted(package.rglob("*.py")):
        source = path.read_text(encoding="utf-8")
        n_kernels += sum(
            is_cached(node) for node in ast.walk(ast.parse(source)) if isinstance(node, ast.FunctionDef)
        )
        found += [f"{path.relative_to(package)}: {text}" for text in foreign_names(source)]
    assert n_kernels > 20  # the scan sees them: a new spelling of the decorator must not blind it
    assert not found, "\n".join(found)


KERNEL = "@njit(cache=True)\ndef f(x: ArrayF) -> float:\n    return x * {}\n"


@pytest.mark.parametrize(
    ("source", "expected"),
    [
        ("from thalweg.a import K\n" + KERNEL.format("K"), ["f uses K of thalweg.a"]),
        ("from thalweg import a\n" + KERNEL.format("a.K"), ["f uses a of thalweg"]),
        ("from .a import g as h\n" + KERNEL.format("h(x)"), ["f uses h of .a"]),
        ("from thalweg.a import K\nL = K + 1\n" + KERNEL.format("L"), ["f uses K of thalweg.a"]),
        (
            "from thalweg.a import K\ndef g():\n    return K\n" + KERNEL.format("g()"),
            ["f uses K of thalweg.a"],
        ),
        ("from thalweg.types import ArrayF\n" + KERNEL.format("2"), []),
        ("import numpy as np\nL = 3\n" + KERNEL.format("np.sqrt(L)"), []),
        ("from thalweg.a import x\n" + KERNEL.format("x"), []),  # the argument hides the import
        ("from thalweg.a import K\n" + KERNEL.format("K").replace("True", "False"), []),
        ("from thalweg.a import K\n" + KERNEL.format("K").replace("cache=True", "nogil=True"), []),
    ],
)
def test_the_scan_sees_what_it_should(source: str, expected: list[str]) -> None:
    assert list(foreign_names(source)) == expected
