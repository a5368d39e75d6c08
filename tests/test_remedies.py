"""Each remedy names what its reader can set: the words of messages, followed from each command to its errors.

A command names its options, a campaign its settings. Functions that both call name settings, for which a
command states the option that stands for each (``set_defaults(settings=...)``), and `thalweg.core.in_options`
puts it in their place. Which messages a command can show is told by who calls whom: names are followed to the
functions and classes that they stand for, methods to those of each class that was named on the way.
"""

import argparse
import ast
import re
import typing
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

import pytest
from pydantic import BaseModel

from thalweg.cli import _parser
from thalweg.core import in_options
from thalweg.settings import Campaign

SOURCE = Path(__file__).parents[1] / "src"
SECTIONS = "|".join(sorted(Campaign.model_fields, key=len, reverse=True))
SETTING = re.compile(rf"(?<![\w./-])(?:{SECTIONS})(?:\.[a-z][a-z_0-9]*)+(?![\w(])")
OPTION = re.compile(r"(?<![\w-])--[a-z][a-z-]*[a-z]")
FILES = re.compile(r"\.(json|html|md|parquet|laz|png|csv|bin|txt|py)$")
OTHERS = {
    *("--force", "--set-resources", "--cores", "--config", "--rerun-incomplete", "--executor", "--profile"),
    *("--unlock", "--until", "--directory", "--models", "--jobs", "--dry-run", "--logger", "--snakefile"),
}
"""Options of Snakemake, and of Kalibr."""
OF_A_CAMPAIGN = re.compile(r"\S+ of a campaign")
OF_CAMPAIGNS = {"new-campaign", "check-config", "catalogue", "costs", "summary", "describe"}
"""Commands whose reader has a campaign file, or wants to know where a file goes in one."""
BY_NAME_ALONE = {"import-calibration", "import-camera"}
"""Commands that share the recognition of files with ``describe``, and none of its other messages."""

CALLING_OTHERS = {"thalweg.workflow.cluster", "thalweg.workflow.provenance"}
"""Modules that run SLURM and Git."""
NO_SETTINGS = {"lidar.x_m", "ins.anpp", "lidar.pcap"}
"""A quantity of a calibration file, and files of the examples of commands."""

Place = tuple[str, str]
"""Module, and the name of a function, ``Class.method``, class or constant in it."""


@dataclass
class Module:
    """What one file defines and imports."""

    imported: dict[str, Place] = field(default_factory=dict)
    defined: dict[str, ast.AST] = field(default_factory=dict)
    classes: set[str] = field(default_factory=set)


@dataclass
class Body:
    """What one definition says and names."""

    words: list[tuple[int, str]]
    names: set[str]
    attributes: set[str]


@cache
def modules() -> dict[str, Module]:
    """All modules of the package, and its front doors."""
    found: dict[str, Module] = {}
    for path in sorted((SOURCE / "thalweg").rglob("*.py*")):
        if path.suffix not in {".py", ".pyi"}:
            continue
        parts = path.relative_to(SOURCE).with_suffix("").parts
        name = ".".join(parts[:-1] if parts[-1] == "__init__" else parts)
        package = name if parts[-1] == "__init__" else name.rpartition(".")[0]
        module = found.setdefault(name, Module())
        tree = ast.parse(path.read_text())
        for node in ast.walk(tree):
            if isinstance(node, ast.ImportFrom):
                up = package.split(".")[: len(package.split(".")) - node.level + 1] if node.level else []
                base = ".".join([*up, *([node.module] if node.module else [])])
                module.imported |= {each.asname or each.name: (base, each.name) for each in node.names}
        for node in tree.body:
            if isinstance(node, ast.FunctionDef):
                module.defined[node.name] = node
            elif isinstance(node, ast.ClassDef):
                module.classes.add(node.name)
                module.defined |= {
                    f"{node.name}.{each.name}": each
                    for each in node.body
                    if isinstance(each, ast.FunctionDef)
                }
            elif isinstance(node, ast.Assign | ast.AnnAssign):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                module.defined |= {each.id: node for each in targets if isinstance(each, ast.Name)}
    return found


@cache
def body(place: Place) -> Body:
    """Words, names and attributes of a definition, its docstring left out."""
    node = modules()[place[0]].defined[place[1]]
    documented = ast.get_docstring(node, clean=False) if isinstance(node, ast.FunctionDef) else None
    within = list(ast.walk(node))
    return Body(
        words=[
            (each.lineno, each.value)
            for each in within
            if isinstance(each, ast.Constant) and isinstance(each.value, str) and each.value != documented
        ],
        names={each.id for each in within if isinstance(each, ast.Name)},
        attributes={each.attr for each in within if isinstance(each, ast.Attribute)},
    )


@cache
def meant(module: str, name: str) -> Place | None:
    """What a name stands for, followed through imports; None outside of the package."""
    here = modules().get(module)
    if here is None:
        return None
    if name in here.defined or name in here.classes:
        return module, name
    return meant(*here.imported[name]) if name in here.imported else None


def reached(start: Place) -> set[Place]:
    """Definitions that a function uses, directly or through others."""
    seen = {start}
    classes: set[Place] = set()
    attributes: set[str] = set()
    todo = [start]

    def follow(place: Place) -> None:
        """Another definition, once."""
        if place not in seen:
            seen.add(place)
            todo.append(place)

    while todo:
        module, name = todo.pop()
        of = body((module, name))
        fresh = of.attributes - attributes
        attributes |= fresh
        for base, cls in classes:
            for each in methods(base, cls) & fresh:
                follow((base, f"{cls}.{each}"))
        for found in filter(None, (meant(module, each) for each in (*of.names, name.partition(".")[0]))):
            base, cls = found
            if cls not in modules()[base].classes:
                follow(found)
            elif found not in classes:
                classes.add(found)
                for each in methods(base, cls):
                    if each in attributes or each.startswith("__"):
                        follow((base, f"{cls}.{each}"))
    return seen


@cache
def methods(module: str, cls: str) -> frozenset[str]:
    """Methods of a class."""
    found = (each.partition(".") for each in modules()[module].defined)
    return frozenset(name for of, _, name in found if of == cls and name)


def messages(start: Place) -> Iterator[tuple[str, str]]:
    """Words that a function can show, with their places."""
    for place in sorted(reached(start)):
        for line, words in body(place).words:
            yield f"{place[0]}:{line}", words


def settings_in(words: str) -> set[str]:
    """Settings of campaigns that words name."""
    found = {each.group().rstrip(".") for each in SETTING.finditer(words)}
    return {each for each in found if not FILES.search(each)}


def exists(setting: str) -> bool:
    """Whether a campaign has such a setting."""
    models: set[type[BaseModel]] = {Campaign}
    for part in setting.split("."):
        found = [each.model_fields[part].annotation for each in models if part in each.model_fields]
        if not found:
            return False
        models = set().union(*map(_models, found))
    return True


def _models(annotation: object) -> set[type[BaseModel]]:
    """Models in an annotation."""
    if isinstance(annotation, type) and not typing.get_args(annotation):
        return {annotation} if issubclass(annotation, BaseModel) else set()
    return set().union(*(_models(each) for each in typing.get_args(annotation)))


@cache
def commands() -> dict[str, argparse.ArgumentParser]:
    """Commands that do something themselves."""
    subparsers = next(a for a in _parser()._actions if isinstance(a, argparse._SubParsersAction))
    return {name: each for name, each in subparsers.choices.items() if each.get_default("command")}


def options_of(parser: argparse.ArgumentParser) -> set[str]:
    """Options of a command."""
    return {each for action in parser._actions for each in action.option_strings}


@pytest.mark.parametrize("name", sorted(set(commands()) - OF_CAMPAIGNS - BY_NAME_ALONE))
def test_a_command_names_its_own_options(name):
    """No setting of a campaign, of which this caller has none, and no option of another command."""
    parser = commands()[name]
    handler = parser.get_default("command")
    renamed = parser.get_default("settings") or {}
    wrong = set()
    for where, words in messages((handler.__module__, handler.__qualname__)):
        shown = in_options(words, renamed)
        wrong |= {f"{where} {each}" for each in settings_in(OF_A_CAMPAIGN.sub("", shown))}
        wrong |= {f"{where} {each}" for each in set(OPTION.findall(shown)) - options_of(parser) - OTHERS}
    assert sorted(wrong) == []


def test_all_that_messages_name_is_there():
    known = set().union(*(options_of(each) for each in _all_parsers())) | OTHERS
    wrong = set()
    for name, module in modules().items():
        for definition in {} if name in CALLING_OTHERS else module.defined:
            for line, words in body((name, definition)).words:
                wrong |= {
                    f"{name}:{line} {each}" for each in settings_in(words) - NO_SETTINGS if not exists(each)
                }
                wrong |= {f"{name}:{line} {each}" for each in set(OPTION.findall(words)) - known}
    assert sorted(wrong) == []


def _all_parsers() -> Iterator[argparse.ArgumentParser]:
    todo = [_parser()]
    while todo:
        parser = todo.pop()
        yield parser
        for action in parser._actions:
            if isinstance(action, argparse._SubParsersAction):
                todo += action.choices.values()


def test_options_that_stand_for_settings_are_both_there():
    for name, parser in commands().items():
        for setting, words in (parser.get_default("settings") or {}).items():
            assert exists(setting) or " " in setting, f"{name}: {setting}"
            assert set(OPTION.findall(words)) <= options_of(parser), f"{name}: {words}"
