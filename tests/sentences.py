"""Sentences of pages and documents, and how long they are: words of running text, not of tables or code."""

import re
from html import unescape

import numpy as np

MEAN, LONGEST = 20.0, 45
"""Words of a sentence, at most: on the average of a page, and alone."""

_FEW = 10
_CODE = r"```.*?```|<!--.*?-->|\$\$.*?\$\$|\{%.*?%\}"
_ABBREVIATIONS = r"\b(?:e\.g|i\.e|Fig|Eq|Sect|No|al|cf|vs|ca|approx|p)\."


def of_html(page: str) -> list[str]:
    """Sentences of paragraphs and of words below pictures and above tables."""
    found = re.findall(r"<(p|figcaption|caption)\b[^>]*>(.*?)</\1>", page, re.S)
    return [each for _, part in found for each in _split(unescape(re.sub(r"<[^>]*>", " ", part)))]


def of_markdown(text: str) -> list[str]:
    """Sentences of paragraphs and of entries of lists."""
    text = re.sub(r"^---\n.*?\n---\n", "", re.sub(_CODE, " ", text, flags=re.S), flags=re.S)
    lines = [line for line in text.splitlines() if not re.match(r"    |\s*(?:\||#|!\[|>|[:=+-]{3})", line)]
    parts = re.split(r"\n\s*\n|\n(?=\s*(?:[-*+]|\d+\.) )", "\n".join(lines))
    plain = (re.sub(r"\]\([^)]*\)|`[^`]*`", lambda m: " code " if m[0][0] == "`" else "", p) for p in parts)
    return [each for part in plain for each in _split(part)]


def _split(text: str) -> list[str]:
    text = re.sub(_ABBREVIATIONS, lambda m: m[0][:-1], " ".join(text.split()))
    return [each for each in re.split(r"(?<=[.?!])\s+(?=[A-Z(\d]|[a-h]: )", text) if length(each) > 2]


def length(sentence: str) -> int:
    """Number of words: what holds a letter."""
    return sum(bool(re.search(r"[^\W\d_]", word)) for word in sentence.split())


def lengths(sentences: list[str]) -> tuple[float, int]:
    """Mean and greatest number of words of a sentence; nothing is of no length."""
    words = [length(each) for each in sentences] or [0]
    return float(np.mean(words)), max(words)


def too_long(sentences: list[str], mean: float = MEAN, longest: int = LONGEST) -> list[str]:
    """What is too long: the average of ten sentences or more, and each single one."""
    found = [f"{length(each)} words: {each!r}" for each in sentences if length(each) > longest]
    average, _ = lengths(sentences)
    few = len(sentences) < _FEW
    return found + ([] if few or average <= mean else [f"{average:.1f} words a sentence on the average"])
