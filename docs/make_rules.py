"""Write docs/rules.md: every rule by subject, from the docstrings of rules and the table of figures.

.venv/bin/python docs/make_rules.py
"""

import re
from collections.abc import Iterator
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]
ROOMS = {
    "simulation": "The digital twin: raw logs of simulated instruments",
    "ingest": "Raw logs to tables, with integrity reports",
    "timing": "One GPS time axis",
    "calibration": "Mounting of the sensors, lenses, clocks",
    "orientation": "Trajectories from INS, camera and both",
    "lidar": "Georeferenced point clouds",
    "without_boat": "Photographs, a fixed camera or a finished cloud alone",
    "panorama": "Panoramas of a camera with two fisheye lenses",
    "triangulation": "The underwater light-sheet sensor",
    "bathymetry": "The riverbed from soundings",
    "fusion": "One terrain model of bed and banks",
    "surface": "Meshes of references",
    "accuracy": "Observed and predicted errors",
    "deformation": "Change between epochs",
    "figures": "Figures and pages",
    "reproduction": "Published tables",
    "studies": "Studies over many surveys of the twin",
}
_RULE = re.compile(
    r'^(?:# ([^\n]+)\n)?(?:rule|use rule \w+ as) (\w+)[^\n]*:\n(?:    """(.*?)""")?', re.M | re.S
)


def rules_of(path: Path) -> Iterator[tuple[str, str]]:
    """Name of each rule in a file, and its docstring, comment above a `use rule`, or words in a table."""
    for comment, name, words in _RULE.findall(path.read_text()):
        yield name, " ".join((words or comment).split("\n\n")[0].split())
    yield from re.findall(r'(?m)^    "(\w+)": \{\n        "shows": "(.+)",$', path.read_text())


def pictures_of(path: Path) -> Iterator[tuple[str, str]]:
    """Name of the rule of each picture in the table of figures, and what it shows."""
    for rows in yaml.safe_load(path.read_text(encoding="utf-8")).values():
        for name, row in rows.items():
            if "draw" in row:
                yield f"plot_{name}", row["shows"]


def page(folder: Path) -> str:
    """The page for a folder of rules files, with the table of figures beside it.

    Raises
    ------
    KeyError : a rules file belongs to no room of `ROOMS`.
    """
    found: dict[str, list[tuple[str, str]]] = {room: [] for room in ROOMS}
    for path in sorted(folder.glob("*.smk")):
        if not path.stem.startswith("common"):
            room = path.stem if path.stem in ROOMS else path.stem.split("_")[0]
            found[room] += rules_of(path)
    found["figures"] += pictures_of(folder.parent / "figures.yaml")
    for path in sorted((folder.parents[1] / "config/studies").glob("*.yaml")):
        entry = yaml.safe_load(path.read_text())
        if "study" in entry:  # one rule of studies.smk for each
            found["studies"].append((path.stem, entry["question"]))
    lines = [
        "# The rules",
        "",
        "Made by `docs/make_rules.py`; `snakemake --rulegraph mermaid-js` draws what a campaign needs.",
        "Short names of sources (T, P1 to P4): [bibliography](bibliography.md).",
    ]
    for room, rules in found.items():
        if rules:
            lines += ["", f"## {room}: {ROOMS[room]}", "", "| rule | what it does |", "| --- | --- |"]
            lines += [f"| `{name}` | {words} |" for name, words in sorted(rules)]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    (ROOT / "docs/rules.md").write_text(page(ROOT / "workflow/rules"))
