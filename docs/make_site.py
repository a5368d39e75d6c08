"""Pages of the documentation's site that come from the code, and links from docs to the rest; `make docs`.

A hook of MkDocs (mkdocs.yml names it). Made here: front page from README.md, command line from the parsers,
settings from config/README.md, notebooks with their results, tables with units from their schemas, a page for
each front door of the library, and graphs as SVG. Nothing is written into docs.
"""

import argparse
import ast
import importlib
import json
import re
import sys
from base64 import b64encode
from collections.abc import Iterator
from functools import partial
from html import escape
from io import BytesIO
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
OUTSIDE = {
    "README.md": "index.md",
    "config/README.md": "reference/settings.md",
    "CHANGELOG.md": "reference/changelog.md",
    "CONTRIBUTING.md": "reference/contributing.md",
    "CITATION.cff": "CITATION.cff",
}
"""Files outside docs that the site shows: place in the repository -> place in the site."""


# ---------------------------------------------------------------- links and graphs


def moved(text: str, place: str, target: str) -> str:
    """Markdown of a file of the repository with its links as the site needs them.

    Links to files that the site does not hold become their words and the path.

    Parameters
    ----------
    text : Markdown.
    place : of the file, from the root of the repository.
    target : of the page, from the root of the site.
    """

    def link(found: re.Match[str]) -> str:
        """One link, from the page's place in the site."""
        words, href, heading = found.groups()
        if not href or re.match(r"[a-z]+:", href):
            return found.group()
        path = (ROOT / place).parent.joinpath(href).resolve().relative_to(ROOT).as_posix()
        path = OUTSIDE.get(path, "docs/validation/README.md" if path == "docs/validation" else path)
        if not path.startswith("docs/") and path not in OUTSIDE.values():
            return f"{words.strip('![]')} (`{path}`)"
        return f"{words}({'../' * target.count('/')}{path.removeprefix('docs/')}{heading})"

    parts = re.split(r"(```.*?```|`[^`\n]*`)", text, flags=re.S)
    parts[::2] = [re.sub(r"(!?\[[^]]*\])\(([^)\s#]*)(#[^)\s]*|)\)", link, part) for part in parts[::2]]
    return "".join(parts)


def graph(mermaid: str) -> str:
    """SVG of a flowchart from top to bottom, in rows by the longest way to a box.

    The theme's own way would fetch a drawing program from the network. Boxes are words or ``name[(words)]``,
    arrows ``a --> b --> c`` and ``a -. words .-> b``.
    """
    words: dict[str, str] = {}
    edges: list[tuple[str, str, bool]] = []
    for line in mermaid.splitlines():
        steps = re.split(r"\s*(-->|-\..*?\.->)\s*", line.strip())
        if len(steps) < 3:
            continue
        boxes = [re.sub(r"[\[(].*", "", step) for step in steps[::2]]
        for name, step in zip(boxes, steps[::2], strict=True):
            words.setdefault(name, "".join(re.findall(r"\[\(?(.*?)\)?\]", step)) or name)
        for k, arrow in enumerate(steps[1::2]):
            edges.append((boxes[k], boxes[k + 1], arrow != "-->"))
    row = dict.fromkeys(words, 0)
    for _ in words:  # as many rounds as the longest way can have
        for a, b, _ in edges:
            row[b] = max(row[b], row[a] + 1)
    rows: dict[int, list[str]] = {}
    for name in words:
        rows.setdefault(row[name], []).append(name)
    wide, high, most = 170, 62, max(map(len, rows.values()))
    x: dict[str, float] = {}
    for k in sorted(rows):
        before = {name: [x[a] for a, b, _ in edges if b == name and a in x] for name in rows[k]}
        rows[k].sort(key=lambda name: sum(before[name]) / max(len(before[name]), 1))
        x |= {name: wide * (i + (most - len(rows[k]) + 1) / 2) for i, name in enumerate(rows[k])}
    lines = []
    for a, b, dashed in edges:
        top, end = high * row[a] + 30, high * row[b] - 5
        side = 1 if x[a] + x[b] >= wide * most else -1  # away from the middle
        bend = 0 if row[b] == row[a] + 1 else 150 * side  # beside the rows between
        curve = f"C{x[a] + bend:.0f},{top + 40} {x[b] + bend:.0f},{end - 40} {x[b]:.0f},{end}"
        stroke = 'stroke="currentColor" stroke-opacity=".5"' + ' stroke-dasharray="4"' * dashed
        lines.append(f'<path d="M{x[a]:.0f},{top} {curve}" fill="none" {stroke} marker-end="url(#tip)"/>')
    for name, text in words.items():
        box = 8 * max(len(text), 4) + 14
        lines.append(
            f'<rect x="{x[name] - box / 2:.0f}" y="{high * row[name]}" width="{box}" height="30" rx="4" '
            f'fill="none" stroke="currentColor"/><text x="{x[name]:.0f}" y="{high * row[name] + 20}" '
            f'text-anchor="middle" font-size="13" fill="currentColor">{escape(text)}</text>'
        )
    size = (wide * most + 4, high * len(rows))
    return (
        f'<svg viewBox="-2 -2 {size[0]} {size[1]}" width="{size[0]}" style="max-width:100%" role="img">'
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="6" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto"><path d="M0,0 L8,4 L0,8 z" fill="currentColor"/></marker></defs>'
        f"{''.join(lines)}</svg>"
    )


# ---------------------------------------------------------------- reference


def command_page() -> str:
    """All commands with their options, from the parsers."""
    cli = importlib.import_module("thalweg.cli")
    commands = next(a for a in cli._parser()._actions if isinstance(a, argparse._SubParsersAction))
    lines = ["# Command line", "", "`.venv/bin/thalweg COMMAND`; lengths are metres, angles degrees.", ""]
    for choice in commands._choices_actions:
        parser = commands.choices[choice.dest]
        parser.formatter_class = partial(argparse.HelpFormatter, width=84)
        usage = parser.format_usage().removeprefix("usage: ").rstrip().replace("\n", "\n    ")
        lines += [
            f"## {choice.dest}",
            "",
            f"{str(choice.help)[:1].upper()}{str(choice.help)[1:]}.",
            "",
            f"    {usage}",
            "",
        ]
        lines += ["| argument | default | meaning |", "| --- | --- | --- |"]
        for action in parser._actions:
            if action.dest == "help":
                continue
            name = ", ".join(action.option_strings) or action.metavar or action.dest
            takes = bool(action.option_strings) and action.nargs != 0
            value = action.metavar or (
                f"{{{','.join(map(str, action.choices))}}}" if action.choices else action.dest.upper()
            )
            value = " ".join(value) if isinstance(value, tuple) else value
            default = "" if action.default in (None, False, [], "") else f"`{action.default}`"
            meaning = (
                (action.help or "").split(" (default: %(default)s)")[0].replace("default: %(default)s", "")
            )
            shown = "required" if action.required else default
            lines.append(f"| `{name}{f' {value}' * takes}` | {shown} | {meaning} |")
        lines.append("")
    return "\n".join(lines)


def table_page() -> str:
    """Every kind of table that Thalweg writes: columns, units, meaning."""
    import pyarrow as pa

    core = importlib.import_module("thalweg.core.tables")
    kinds: dict[str, pa.Schema] = {}
    for path in sorted((ROOT / "src/thalweg").rglob("*.py")):
        if "table_kind(" in path.read_text(encoding="utf-8"):
            name = ".".join(path.relative_to(ROOT / "src").with_suffix("").parts)
            for value in vars(importlib.import_module(name)).values():
                if isinstance(value, pa.Schema) and core.kind_of(value)[0]:
                    kinds[core.kind_of(value)[0]] = value
    lines = [
        "# Tables and units",
        "",
        "Parquet tables carry kind, version, unit and meaning of each column in their own schema. Times are "
        "seconds of GPS time; frames are those of the [conventions](../conventions.md).",
        "",
    ]
    for kind, schema in sorted(kinds.items()):
        lines += [f"## {kind}", "", f"Version {core.kind_of(schema)[1]}.", ""]
        lines += ["| column | type | unit | meaning |", "| --- | --- | --- | --- |"]
        for field in schema:
            unit, meaning = (field.metadata[key].decode().replace("|", "\\|") for key in (b"unit", b"doc"))
            lines.append(f"| `{field.name}` | {field.type} | {unit} | {meaning} |")
        lines.append("")
    return "\n".join(lines)


def doors() -> Iterator[tuple[str, dict[str, list[str]]]]:
    """Packages with a front door: name -> what each of its modules offers."""
    for path in sorted((ROOT / "src/thalweg").rglob("__init__.pyi")):
        package = ".".join(path.parent.relative_to(ROOT / "src").parts)
        offers: dict[str, list[str]] = {}
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ImportFrom) and node.module:
                offers.setdefault(node.module, []).extend(alias.name for alias in node.names)
        yield package, offers


def foreign(text: str) -> dict[str, str]:
    """Names that the text of a module takes from other libraries, and from which."""
    return {
        alias.asname or alias.name: node.module
        for node in ast.parse(text).body
        if isinstance(node, ast.ImportFrom) and node.module and not node.level
        for alias in node.names
        if not node.module.startswith("thalweg")
    }


def door_page(package: str, offers: dict[str, list[str]]) -> str:
    """What a package offers, by module, for mkdocstrings."""
    path = ROOT / "src" / Path(*package.split(".")) / "__init__.py"
    words = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    names = [name for each in offers.values() for name in each]
    example = next((name for name in names if name.islower()), names[0] if names else "")
    lines = [f"# {package}", "", words, "", f"    from {package} import {example}", ""]
    for module, names in offers.items():
        lines += [f"## {module}", ""]
        source = path.parent / f"{module.replace('.', '/')}.py"
        text = source.read_text(encoding="utf-8") if source.is_file() else ""
        own = all(re.search(rf"(?m)^(?:def |class )?{name}\b", text) for name in names)
        others = {} if own or not text else foreign(text)
        for name in names:
            lines += [
                f"`{name}`: of {others[name]}" if name in others else f"::: {package}.{module}.{name}",
                "",
            ]
    return "\n".join(lines)


def notebook_page(path: Path) -> str:
    """A notebook with what its cells give: text of the last expression, and figures within the page.

    Parameters
    ----------
    path : ``.ipynb``; its cells are run one after another in a namespace of their own.
    """
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    lines: list[str] = []
    names: dict[str, Any] = {"__name__": path.stem}
    for k, cell in enumerate(json.loads(path.read_text(encoding="utf-8"))["cells"]):
        text = "".join(cell["source"])
        if cell["cell_type"] == "markdown":
            lines += [text, ""]
            continue
        lines += ["```python", text, "```", ""]
        tree, value = ast.parse(text, f"{path.name}, cell {k}"), None
        last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
        exec(compile(tree, f"{path.name}, cell {k}", "exec"), names)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), f"{path.name}, cell {k}", "eval"), names)
        if value is not None and not text.endswith(";"):
            lines += ["```text", str(value), "```", ""]
        for number in plt.get_fignums():
            picture = BytesIO()
            plt.figure(number).savefig(picture, format="png", dpi=110)
            lines += [f"![Figure](data:image/png;base64,{b64encode(picture.getvalue()).decode()})", ""]
        plt.close("all")
    return "\n".join([*lines, f"Notebook: [{path.name}]({path.name})", ""])


def generated() -> dict[str, str]:
    """Pages of the site that no file of docs holds: place in the site -> Markdown."""
    sys.path.insert(0, str(ROOT / "src"))  # MkDocs puts back what a hook changes while it is loaded
    pages = {
        target: moved((ROOT / place).read_text(encoding="utf-8"), place, target)
        for place, target in OUTSIDE.items()
        if target.endswith(".md")
    }
    pages |= {
        path.relative_to(ROOT / "docs").with_suffix(".md").as_posix(): notebook_page(path)
        for path in sorted((ROOT / "docs/notebooks").glob("*.ipynb"))
    }
    pages |= {"reference/cli.md": command_page(), "reference/tables.md": table_page()}
    lines = [
        "# Library",
        "",
        "Names are taken from the front door of a package: `from thalweg.lidar import georeference_log`.",
        "",
    ]
    lines += ["| package | offers |", "| --- | --- |"]
    for package, offers in doors():
        pages[f"api/{package}.md"] = door_page(package, offers)
        names = [name for each in offers.values() for name in each]
        lines.append(f"| [{package}]({package}.md) | {', '.join(names[:6])}{', …' * (len(names) > 6)} |")
    return pages | {"api/index.md": "\n".join(lines) + "\n"}


# ---------------------------------------------------------------- hooks of MkDocs


def on_config(config: Any) -> Any:
    """Put the pages of the library into the navigation, packages of packages below them."""
    tree: list[Any] = [{"Overview": "api/index.md"}]
    for package, _ in doors():
        top = package.split(".")[1]
        if not tree[1:] or next(iter(tree[-1])) != top:
            tree.append({top: []})
        tree[-1][top].append({package.removeprefix("thalweg."): f"api/{package}.md"})
    tree[1:] = [
        pages[0] if len(pages) == 1 else {top: pages} for item in tree[1:] for top, pages in item.items()
    ]
    config["nav"] = [{"Library": tree} if item == {"Library": "api"} else item for item in config["nav"]]
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the generated pages."""
    from mkdocs.structure.files import File

    for target, text in generated().items():
        files.append(File.generated(config, target, content=text))
    files.append(File.generated(config, "CITATION.cff", abs_src_path=str(ROOT / "CITATION.cff")))
    return files


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Links of pages in docs to files outside, and graphs."""
    target = page.file.src_uri
    if (ROOT / "docs" / target).is_file():
        markdown = moved(markdown, f"docs/{target}", target)
    return re.sub(r"```mermaid\n(.*?)```", lambda found: graph(found.group(1)), markdown, flags=re.S)
