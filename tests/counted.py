"""Compare the tests of each folder with `counted.csv`: run by ``make check``.

A row without a reason says how many tests a folder ever had, and grows by itself; tests that went on purpose
are a row of their own, ``folder,number,why``. So a merge that loses tests fails, also where it brings others.
After a merge both sides' rows stand in the file (`.gitattributes`), and the larger figure holds.
"""

import ast
import csv
import sys
from collections import Counter
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[1]


def count_tests(path: Path) -> int:
    """Test functions of a file, those of classes with them."""
    return sum(
        isinstance(node, ast.FunctionDef) and node.name.startswith("test_")
        for node in ast.walk(ast.parse(path.read_text()))
    )


def count_by_folder(tests: Path) -> Counter[str]:
    """Test functions below each folder of ``tests``; its own files are the folder ``.``."""
    found = Counter[str]()
    for path in tests.rglob("test_*.py"):
        inside = path.relative_to(tests)
        found[inside.parts[0] if len(inside.parts) > 1 else "."] += count_tests(path)
    return found


def compared(found: Counter[str], rows: list[list[str]]) -> tuple[list[str], list[list[str]]]:
    """What is lost, in words, and the rows with the figures of today."""
    ever: dict[str, int] = {}
    for folder, number, why in rows:
        if not why:
            ever[folder] = max(ever.get(folder, 0), int(number))
    taken = Counter[str]()
    for folder, number, why in rows:
        taken[folder] += int(number) if why else 0
    lost = [
        f"tests/{folder} has {found[folder]} tests, {lacking} fewer than tests/counted.csv says: take them"
        f" from the parents of the merge, or add the row `{folder},{lacking},why`"
        for folder in ever
        if (lacking := ever[folder] - taken[folder] - found[folder]) > 0
    ]
    now = {f: str(max(ever.get(f, 0), found[f] + taken[f])) for f in sorted({*found, *ever})}
    return lost, [*([folder, number, ""] for folder, number in now.items()), *(row for row in rows if row[2])]


def main() -> int:
    """Write figures that have grown; 1 where one has fallen."""
    file = REPOSITORY / "tests/counted.csv"
    with file.open(newline="") as stream:
        head, *rows = csv.reader(stream)
    lost, new = compared(count_by_folder(REPOSITORY / "tests"), rows)
    print(*lost, sep="\n", end="\n" * bool(lost))
    if new != rows and not lost:
        with file.open("w", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerows([head, *new])
        print("tests/counted.csv: figures have grown; commit them")
    return int(bool(lost))


if __name__ == "__main__":
    sys.exit(main())
