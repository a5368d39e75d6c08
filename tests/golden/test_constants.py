"""Every number that the library has by itself stands once more in `modules/constants/`: thresholds, defaults.

What a threshold is for stands beside it in the source. This list shows a change of it that nobody meant, as
the returns that are stored do (`returns`): ``THALWEG_RETURNS=store pytest tests/golden/test_constants.py``.
"""

import ast
import csv
import importlib
import inspect
from dataclasses import MISSING, fields, is_dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.golden import returns


def constants_of(module: str) -> dict[str, str]:
    """Numbers that a module gives names to, and defaults of its functions, methods and classes."""
    loaded = importlib.import_module(module)
    path = returns.SOURCE / f"{module.replace('.', '/')}.py"
    found: dict[str, str] = {}

    def add(name: str, value: Any) -> None:
        if isinstance(value, bool | int | float):
            found[name] = f"{value:.12g}"
        elif text := returns.summary(value):
            found[name] = text

    for node in ast.parse(path.read_text()).body:
        for target in getattr(node, "targets", [getattr(node, "target", None)]):
            if isinstance(target, ast.Name):
                add(target.id, getattr(loaded, target.id, None))
    for name, function in returns.functions_of(module).items():
        for parameter in inspect.signature(function).parameters.values():
            if parameter.default is not inspect.Parameter.empty:
                add(f"{name}({parameter.name})", parameter.default)
    for name, value in vars(loaded).items():
        if inspect.isclass(value) and value.__module__ == module:
            for field, default in _defaults(value).items():
                add(f"{name}.{field}", default)
    return found


def _defaults(kind: type) -> dict[str, Any]:
    """Of the fields of a class, those that have one."""
    if is_dataclass(kind):
        made = {f.name: f.default_factory() for f in fields(kind) if f.default_factory is not MISSING}
        return {f.name: f.default for f in fields(kind) if f.default is not MISSING} | made
    if hasattr(kind, "model_fields"):
        return {
            name: field.get_default(call_default_factory=True) for name, field in kind.model_fields.items()
        }
    return dict(getattr(kind, "_field_defaults", {}))


@pytest.mark.parametrize("package", sorted({name.split("/")[1] for name in returns.modules()}))
def test_no_number_changes_unseen(package: str, request: pytest.FixtureRequest) -> None:
    """A row for each name, by package; a new name is no difference."""
    modules = [name.replace("/", ".") for name in returns.modules() if name.split("/")[1] == package]
    now = {
        f"{module}:{name}": text for module in modules for name, text in sorted(constants_of(module).items())
    }
    file: Path = returns.STORE / "constants" / f"{package}.csv"
    if returns.MODE == "store":
        with file.open("w", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerows(now.items())
    with file.open(newline="") as stream:
        stored = dict(csv.reader(stream))
    differ = [
        f"{name}: {text} is {now.get(name, 'nothing')} now"
        for name, text in stored.items()
        if text != now.get(name)
    ]
    returns.differs(request.node.nodeid, differ)
