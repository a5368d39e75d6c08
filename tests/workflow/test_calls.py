"""Rules whose script is call.py or page.py give the function that they name what its parameters ask for."""

import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import get_type_hints


def calls(repository: Path) -> Iterator[tuple[str, str, set[str]]]:
    """Each rule or page, ``module:function`` that it names, and the names that it gives."""
    for path in sorted((repository / "workflow/rules").glob("*.smk")):
        text = path.read_text()
        for body in re.split(r"(?m)^rule ", text)[1:]:
            if called := re.search(r'\*\*calls\("([\w.:]+)"\)', body):
                fields = re.sub(r"(?ms)^    resources:.*?(?=^    \w)", "", body.split("\n\n\n")[0])
                yield body.split(":")[0], called[1], set(re.findall(r"(?m)^        (\w+)=", fields))
        for name, body in re.findall(r'(?ms)^    "(\w+)": \{\n(.*?)^    \},', text):
            called = re.search(r'"calls": "([\w.:]+)"', body)
            assert called, name
            of_pages = {"page", "twin", "title"} if name.endswith("_page") else set()
            yield name, called[1], {*of_pages, *re.findall(r'(?m)(?:^ {12}|\{)"(\w+)":', body)}


def test_rules_give_what_their_functions_take(repository):
    found = list(calls(repository))
    assert len(found) > 20
    for rule, called, given in found:
        module, name = called.split(":")
        function = getattr(import_module(module), name)
        get_type_hints(function)  # `job_arguments` asks for them
        parameters = inspect.signature(function).parameters
        # a front door has no code of its own, whose version could be asked for
        assert function.__module__ == module, rule
        needed = {key for key, each in parameters.items() if each.default is inspect.Parameter.empty}
        assert needed - {"threads"} <= given, rule
        # what is written beside a file, or into a folder, that the function is given; page.py writes pages
        of_pages = {"page", "twin"} if rule.endswith("_page") else set()
        assert "folder" in given or given - set(parameters) <= {"covariance"} | of_pages, rule
