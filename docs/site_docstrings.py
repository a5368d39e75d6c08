"""Docstrings of the library as the site shows them: an extension of griffe (mkdocs.yml names it)."""

import re
from typing import Any

import griffe


def listed(text: str) -> str:
    """A docstring whose ``name : meaning`` stands in the form that griffe reads: meaning on the next line.

    The library's docstrings leave types to annotations; numpydoc's parser would take the meaning for a type.
    """
    parts = re.split(r"(?m)^(Parameters|Other Parameters|Attributes|Raises|Yields|Returns)\n-+\n", text)
    for k in range(2, len(parts), 2):
        parts[k] = re.sub(r"(?m)^([*\w][\w, *.`]*?) ?: (.+)$", r"\1\n    \2", parts[k])
        parts[k] = f"{parts[k - 1]}\n{'-' * len(parts[k - 1])}\n{parts[k]}"
    return "".join([parts[0], *parts[2::2]])


class FieldList(griffe.Extension):
    """Rewrites docstrings before they are parsed."""

    def on_object(self, *, obj: griffe.Object, **_: Any) -> None:
        """Called for every module, class, function and attribute."""
        if obj.docstring:
            obj.docstring.value = listed(obj.docstring.value)
