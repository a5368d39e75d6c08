"""Front page of a campaign: what there is, what one more log would add, every page and every picture."""

import re
from collections.abc import Mapping, Sequence
from html import unescape
from os.path import relpath
from pathlib import Path
from typing import Any, Final

import pandas as pd

from thalweg.accuracy import number_text
from thalweg.core import InputError, final_path
from thalweg.figures.page import Page
from thalweg.figures.style import note_of

_HEADING: Final = re.compile(r"<h1>(.*?)</h1>\s*(?:<p>(.*?)</p>)?", re.DOTALL)
_SENTENCE: Final = re.compile(r"^.*?[.!?](?=\s|$)", re.DOTALL)


def front_page(
    target: Path,
    *,
    title: str,
    twin: bool,
    products: Sequence[Mapping[str, Any]],
    pages: Sequence[Path],
    pictures: Sequence[Path],
    captions: Mapping[str, str],
    summary: pd.DataFrame | None,
) -> Page:
    """The page that a person opens first.

    Parameters
    ----------
    target : where it will stand; links are relative to its folder.
    title : heading.
    twin : whether a digital twin wrote the logs.
    products : name, file, made (whether the logs make it) and needs of each; none but for a survey.
    pages : HTML files; each gets a link with its own heading and the first sentence of its lead. Layers for a
        GIS among them are linked by ``products``.
    pictures, captions : PNG files, and by stem what they show.
    summary : columns quantity, value, unit; None: there is none.

    Raises
    ------
    InputError : a page without a heading.
    """

    def at(path: Path | str) -> str:
        """Address from the front page."""
        return Path(relpath(path, final_path(target).parent)).as_posix()

    page = Page(title, "Digital twin: simulated instruments wrote these logs." if twin else "")
    if linked := [path for path in pages if path.suffix == ".html"]:
        page.section("Pages").links({at(path): _heading(path) for path in linked})
    if products:
        page.section("Products")
        page.links({at(each["file"]): (each["name"], "") for each in products if each["made"]})
        lacking = [(each["name"], each["needs"]) for each in products if not each["made"]]
        if lacking:
            page.table(pd.DataFrame(lacking, columns=["not made", "needs"]), "What more logs would add.")
    if summary is not None:
        page.section("Figures of the survey")
        shown = summary[["quantity", "value", "unit"]].assign(
            value=summary["value"].map(number_text), unit=summary["unit"].replace("1", "")
        )
        page.table(shown, "The most important figures.")
    reasons = {path: note_of(path) for path in pictures if path.suffix == ".png"}
    page.section("Pictures")
    page.thumbnails(
        {at(path): (path, captions.get(path.stem, path.stem)) for path, why in reasons.items() if why is None}
    )
    empty = [(captions.get(p.stem, p.stem), why) for p, why in reasons.items() if why is not None]
    if empty:
        page.table(pd.DataFrame(empty, columns=["picture", "why"]), "Pictures that have nothing to show.")
    return page


def write_front_page(
    *,
    pages: list[Path],
    pictures: list[Path],
    summary: list[Path],
    products: list[dict[str, Any]],
    captions: dict[str, str],
    title: str,
    twin: bool,
    page: Path,
) -> None:
    """The same from files, as the workflow has them; `summary`: none or one."""
    front_page(
        page,
        title=title,
        twin=twin,
        products=products,
        pages=pages,
        pictures=pictures,
        captions=captions,
        summary=pd.read_csv(summary[0]) if summary else None,
    ).write(page)


def _heading(path: Path) -> tuple[str, str]:
    """Heading of a page, and the first sentence below it."""
    found = _HEADING.search(path.read_text(encoding="utf-8"))
    if found is None:
        raise InputError("a page without a heading", expected="a page that Thalweg wrote", where=path)
    lead = unescape(re.sub(r"<[^>]+>", "", found[2] or ""))
    sentence = _SENTENCE.match(lead)
    return unescape(found[1]), sentence[0] if sentence else lead
