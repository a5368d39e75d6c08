"""The site of the documentation, as far as it can be told without MkDocs: pages, navigation, links."""

import re
import runpy
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml


@pytest.fixture(scope="module")
def site(repository):
    return runpy.run_path(str(repository / "docs/make_site.py"))


@pytest.fixture(scope="module")
def pages(site, repository):
    """Markdown of all pages, by their place in the site."""
    docs = repository / "docs"
    own = {
        path.relative_to(docs).as_posix(): path for path in docs.rglob("*.md") if "pages" not in path.parts
    }
    moved = {
        place: site["moved"](path.read_text(encoding="utf-8"), f"docs/{place}", place)
        for place, path in own.items()
    }
    return moved | site["generated"]()


def leaves(nav: Any) -> Iterator[str]:
    """Pages of a navigation."""
    if isinstance(nav, str):
        yield nav
    else:
        for item in nav.values() if isinstance(nav, dict) else nav:
            yield from leaves(item)


def test_the_navigation_holds_every_page(site, pages, repository):
    config = yaml.safe_load((repository / "mkdocs.yml").read_text())
    listed = list(leaves(site["on_config"](config)["nav"]))
    assert len(listed) == len(set(listed))
    records = {place for place in pages if place.startswith("validation/")}
    records -= {f"validation/{name}.md" for name in ("README", "real", "real_consistency", "real_voyage")}
    assert set(listed) == set(pages) - records


def test_links_of_the_site_lead_to_pages(pages, repository):
    root, dead = Path("/site"), []
    for place, text in pages.items():
        plain = re.sub(r"```.*?```|`[^`\n]*`", "", text, flags=re.S)
        for target in re.findall(r"\]\(([^)\s#]+)(?:#[^)]*)?\)", plain):
            if re.match(r"[a-z]+:", target):
                continue
            path = (root / place).parent.joinpath(target).resolve().relative_to(root).as_posix()
            if path not in pages and not (repository / "docs" / path).is_file() and path != "CITATION.cff":
                dead.append((place, target))
    assert dead == []


def test_a_link_out_of_the_site_becomes_words(site):
    text = "[a](../README.md#try-it) [b](images.md) [c](../Makefile) `[d](../Makefile)` [e](https://x.org)"
    made = "[a](../index.md#try-it) [b](../images.md) c (`Makefile`) `[d](../Makefile)` [e](https://x.org)"
    assert site["moved"](text, "docs/tutorial.md", "howto/tutorial.md") == made


def test_the_reference_is_complete(pages, repository):
    commands = pages["reference/cli.md"]
    assert "| `--trusted-baseline KM` | `20.0` | ambiguity fixes over a longer baseline" in commands
    assert "| `FILE` | required | campaign file, or id of one |" in commands
    assert (
        "| `sigma_east` |" not in pages["reference/tables.md"]
    )  # a dimension of clouds, no column of tables
    assert "| `cov_" in pages["reference/tables.md"]
    assert "## ins_state\n\nVersion " in pages["reference/tables.md"]
    doors = {path.parent for path in (repository / "src/thalweg").rglob("__init__.pyi")}
    assert sum(place.startswith("api/thalweg.") for place in pages) == len(doors) > 50
    assert "::: thalweg.lidar.cloud.georeference_log\n" in pages["api/thalweg.lidar.md"]
    assert "`prange`: of numba" in pages["api/thalweg.core.md"]


def test_notebooks_are_shown_with_what_their_cells_give(pages):
    """Their own assertions hold when the site is made."""
    point, clouds = pages["notebooks/lidar_point.md"], pages["notebooks/two_clouds.md"]
    assert re.search(r"```text\nNEES (0\.9[789]|1\.0[012])", point)
    assert "```text\n                             roughness alone  with shared errors" in clouds
    for page in (point, clouds):
        assert page.count("](data:image/png;base64,") == 1


def test_a_graph_needs_no_network(site):
    drawn = site["graph"]("flowchart LR\n    a[(raw logs)] --> b --> c\n    d -. twin .-> a\n")
    boxes = re.findall(r'<rect x="[\d.]+" y="(\d+)".*?>([\w ]+)</text>', drawn)
    rows = sorted({int(y) for y, _ in boxes})
    assert {words: rows.index(int(y)) for y, words in boxes} == {"d": 0, "raw logs": 1, "b": 2, "c": 3}
    assert drawn.count('<path d="M') == 4  # three arrows and the tip
    assert drawn.count("stroke-dasharray") == 1
    assert "http" not in drawn
