"""How much code there is to read, by package: ``make size``; ``--write`` renews docs/architecture.md.

Counted are tokens of Python (names, numbers, operators, strings), so that neither line breaks nor comments
nor docstrings weigh. A test refuses a package that has grown by more than a tenth beyond its row there: who
adds much says so in the same commit.
"""

import re
import sys
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/pages/architecture.md"
SLACK = 1.1
_STRING = r"""(?i:[rbuf]{0,2})
    (?s: \"{3}(?:\\.|[^\\])*?\"{3} | '{3}(?:\\.|[^\\])*?'{3} | "(?:\\.|[^"\\])*" | '(?:\\.|[^'\\])*')"""
_TOKEN = re.compile(
    rf"""(?m:(?<!\\\n)^)[ \t]*{_STRING}  # a docstring, or what else begins a line
    | \#.*
    | ({_STRING}  # what stands in this group counts
    | [^\W\d]\w*
    | 0[xXbBoO]\w+ | (?:\d[\d_]*\.?[\d_]*|\.\d[\d_]*)(?:[eE][+-]?\d+)?[jJ]?
    | \.{{3}} | -> | := | (?:\*\*|//|<<|>>|[-+*/%&|^@=<>!])=? | [^\s\w\\])""",
    re.VERBOSE,
)
"""Tokens as `tokenize` has them, in a quarter of its time."""
_ROW = re.compile(r"^\| `([\w/.]+)` \| ([\d,]+) \|$", re.M)


def tokens_of(source: str) -> int:
    """Tokens without comments, docstrings and what only lays out."""
    return sum(map(bool, _TOKEN.findall(source)))


def measured() -> Counter[str]:
    """Tokens by package of the library and the laboratory, by folder elsewhere."""
    found = Counter[str]()
    for top in ("src/thalweg", "src/thalweg_lab", "workflow", "tests"):
        for path in sorted((ROOT / top).rglob("*")):
            if path.suffix in (".py", ".smk"):
                parts = path.relative_to(ROOT).parts[:-1]
                n = tokens_of(path.read_text())
                found[top] += n
                if top == "src/thalweg" and len(parts) > 2:
                    found["/".join(parts[:3])] += n
    return found


def stated() -> dict[str, int]:
    """Tokens by package as docs/architecture.md has them."""
    return {name: int(number.replace(",", "")) for name, number in _ROW.findall(PAGE.read_text())}


def main() -> None:
    """Print both; with ``--write`` write the table anew."""
    now, then = measured(), stated()
    print(f"{'tokens':>10} {'stated':>10}  where")
    for name, n in now.most_common():
        print(f"{n:>10,} {then.get(name, 0):>10,}  {name}")
    if "--write" in sys.argv:
        rows = "\n".join(f"| `{name}` | {n:,} |" for name, n in now.most_common())
        text = re.sub(
            r"(<!-- size -->\n).*?(<!-- /size -->)",
            rf"\g<1>| package | tokens |\n| --- | ---: |\n{rows}\n\2",
            PAGE.read_text(),
            flags=re.S,
        )
        PAGE.write_text(text)


if __name__ == "__main__":
    main()
