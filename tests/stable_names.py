"""Names that a version keeps (docs/stable.md), as they are in the code, beside the list of them.

.venv/bin/python tests/stable_names.py      # write the list: new names join it, names that are gone leave it
"""

import argparse
import json
import re
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(REPOSITORY / "src"))
LISTED = REPOSITORY / "tests/stable_names.txt"
NOT_STABLE = ("commands", "workflow", "figures")
"""Packages whose front doors serve the command line, Snakemake and pages."""


def _options(parser: argparse.ArgumentParser, words: str) -> Iterator[str]:
    yield f"command {words}"
    for action in parser._actions:
        if isinstance(action, argparse._SubParsersAction):
            for name, below in action.choices.items():
                yield from _options(below, f"{words} {name}")
        else:
            yield from (f"option {words} {each}" for each in action.option_strings if each != "--help")


def names(root: Path = REPOSITORY) -> set[str]:
    """All stable names, each with its sort before it."""
    from thalweg.cli import _parser

    found = set(_options(_parser(), "thalweg"))
    schema = json.loads((root / "config/schema.json").read_text(encoding="utf-8"))
    for section, told in {"campaign file": schema, **schema["$defs"]}.items():
        found |= {f"setting {section}.{key}" for key in told.get("properties", ())}
    source = root / "src/thalweg"
    for path in source.rglob("*.py"):
        kinds = re.findall(r'table_kind\(\s*"(\w+)",\s*(\d+)', path.read_text(encoding="utf-8"))
        found |= {f"table {kind} {version}" for kind, version in kinds}
    for door in source.rglob("__init__.pyi"):
        package = door.parent.relative_to(root / "src")
        if not set(package.parts) & set(NOT_STABLE):
            exported = re.findall(r"\bas (\w+)", door.read_text(encoding="utf-8"))
            found |= {f"name {'.'.join(package.parts)}.{each}" for each in exported}
    page = (root / "docs/outputs.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    found |= {f"file {each}" for row in rows for each in re.findall(r"`([^`]+)`", row)}
    extras = tomllib.loads((root / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return found | {f"extra {each}" for each in extras["optional-dependencies"] if each != "dev"}


def listed() -> set[str]:
    """The list."""
    return set(LISTED.read_text(encoding="utf-8").splitlines())


if __name__ == "__main__":
    LISTED.write_text("\n".join(sorted(names())) + "\n", encoding="utf-8")
