"""A page of text, tables and pictures in one HTML file: no scripts, nothing fetched from anywhere."""

import base64
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from html import escape as escaped, unescape
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, Self
from urllib.parse import quote

import pandas as pd
from matplotlib.figure import Figure
from PIL import Image

from thalweg.core import InputError, final_path
from thalweg.figures.style import NOTHING, count, dashed, number, save

PNG_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
THUMBNAIL_PX: Final = 400

STYLE: Final = Path(__file__).with_name("page.css").read_text(encoding="utf-8")


SOURCES: Final = {
    "T": "Sardemann, H. (2024): Conception and Realisation of a Photogrammetric Multisensor System for an "
    "Uncrewed Water Vehicle. PhD thesis, TU Dresden.",
    "P1": "Sardemann, H., Eltner, A., Maas, H.-G. (2018): Acquisition of Geometrical Data of Small Rivers "
    "with an Unmanned Water Vehicle. doi:10.5194/isprs-archives-XLII-2-1023-2018",
    "P2": "Sardemann, H. et al. (2023): Camera-Aided Orientation of Mobile Lidar Point Clouds Acquired from "
    "an Uncrewed Water Vehicle. doi:10.3390/s23136009",
    "P3": "Sardemann, H., Mulsow, C., Maas, H.-G. (2021): Strict Geometric Calibration of an Underwater "
    "Laser Triangulation System. doi:10.5194/isprs-archives-XLIII-B2-2021-689-2021",
    "P4": "Sardemann, H., Mulsow, C., Maas, H.-G. (2022): Accuracy Analysis of an Oblique Underwater Laser "
    "Lightsheet Triangulation System. doi:10.1007/s41064-022-00196-x",
}
"""Short names of sources, as docs/bibliography.md has them: a page that uses one explains it at its end."""


Pictures = Mapping[str, Figure | Path] | Sequence[Path]
"""Figures or PNG files by name; of files alone the stem is the name."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One of the few numbers at the head of a page.

    Parameters
    ----------
    quantity : what it is.
    value : with unit and number of values, as people write it.
    verdict : one of `VERDICTS` where a standard deviation is judged, else what follows from the number, or
        nothing.
    href : relative address of what it rests on, if that is another page.
    """

    quantity: str
    value: str
    verdict: str = ""
    href: str = ""


TONES: Final = {
    "consistent": "good",
    "no gap": "good",
    "nothing lost or damaged": "good",
    "something is missing": "unsure",
    "too optimistic": "bad",
    "too pessimistic": "unsure",
    "too few data": "unsure",
    "to judge": "unsure",
    "to judge its sigma": "unsure",
}
"""Colours of verdicts by their last words; the verdict itself is beside the colour."""
_LONG_VALUE: Final = 20
"""A longer value of a finding is written in smaller letters."""


JUDGED: Final = {
    "consistent": "the predicted standard deviations agree with the errors",
    "too optimistic": "the predicted standard deviations are too small",
    "too pessimistic": "the predicted standard deviations are too large",
    "too few data": "too few data to judge the predicted standard deviations",
}
"""Verdicts of `thalweg.accuracy` in a sentence, after what they rest on and a colon."""


class Page:
    """A self-contained HTML page, built from top to bottom; each method returns the page.

    Parameters
    ----------
    title : heading and name of the page.
    lead : first paragraph, above the list of contents: one sentence.
    findings : the numbers that matter most, five or so, each with its verdict, below the lead.
    folded : below the lead stand the first figure and the first table, and each section is folded; else all
        is open, in the order in which it was added, with a list of contents.

    Examples
    --------
    >>> page = Page("Logs").section("Lidar").text("52 revolutions & no gap")
    >>> "52 revolutions &amp; no gap" in page.html()
    True
    """

    def __init__(
        self, title: str, lead: str = "", findings: Sequence[Finding] = (), *, folded: bool = True
    ) -> None:
        self.title, self._folded = title, folded
        self._lead = (f"<p>{escape(lead)}</p>\n" if lead else "") + findings_html(findings)
        self._body: list[str] = []
        self._contents: list[tuple[str, str]] = []

    def section(self, name: str) -> Self:
        """Begin a section; it gets a line in the list of contents."""
        stem = re.sub(r"[^a-z0-9]+", "-", name.lower()).strip("-") or "section"
        used = {address for address, _ in self._contents}
        anchor, number = stem, 2
        while f"#{anchor}" in used:
            anchor, number = f"{stem}-{number}", number + 1
        self._body.append(f'<h2 id="{anchor}">{escape(name)}</h2>')
        return self.entry(f"#{anchor}", name)

    def entry(self, address: str, words: str) -> Self:
        """Add a line to the list of contents: an anchor of the page, or another page."""
        self._contents.append((address, words))
        return self

    def text(self, words: str) -> Self:
        """Add text; blank lines separate paragraphs."""
        parts = [part.strip() for part in re.split(r"\n\s*\n", words) if part.strip()]
        self._body += [f"<p>{escape(part)}</p>" for part in parts]
        return self

    def raw(self, part: str) -> Self:
        """Add HTML that the caller has escaped."""
        self._body.append(part)
        return self

    @contextmanager
    def fold(self, title: str) -> Iterator[Self]:
        """What is added within stands folded below a line to click; on paper it is open.

        Examples
        --------
        >>> page = Page("Accuracy").text("RMSE 4 cm.")
        >>> with page.fold("All numbers"):
        ...     _ = page.text("n = 7")
        >>> "<details><summary>All numbers</summary>" in page.html()
        True
        """
        self._body.append(f"<details><summary>{escape(title)}</summary>")
        yield self
        self._body.append("</details>")

    def lines(self, lines: list[str]) -> Self:
        """Add lines of fixed width, such as those of `IntegrityReport.lines`."""
        self._body.append(f'<pre tabindex="0">{escape(chr(10).join(lines))}</pre>')
        return self

    def figure(self, picture: Figure | Path, caption: str, *, dpi: int = 130) -> Self:
        """Add a picture: a figure, drawn at ``dpi``, or a PNG file.

        Raises
        ------
        InputError : the file is missing or no PNG.
        """
        self._body.append(
            f'<figure><img alt="{escape(caption)}" src="{data_address(_png(picture, dpi), "png")}">'
            f"<figcaption>{escape(caption)}</figcaption></figure>"
        )
        return self

    def pictures(
        self,
        pictures: Pictures,
        captions: Mapping[str, str] | None,
        first: str = "",
        *,
        section: str = "Figures",
    ) -> Self:
        """Add a section of pictures with their captions, if there are any; the one named ``first`` leads."""
        named = pictures if isinstance(pictures, Mapping) else {path.stem: path for path in pictures}
        if named:
            self.section(section)
        for name in sorted(named, key=lambda each: each != first):
            self.figure(named[name], (captions or {}).get(name, name.replace("_", " ")))
        return self

    def links(self, targets: Mapping[str, tuple[str, str]]) -> Self:
        """Add a list of links: relative address -> (words of the link, sentence beside it)."""
        items = "".join(
            f'<li><a href="{quote(href)}">{escape(words)}</a>{": " * bool(sentence)}{escape(sentence)}</li>\n'
            for href, (words, sentence) in targets.items()
        )
        self._body.append(f"<ul>\n{items}</ul>")
        return self

    def thumbnails(self, pictures: Mapping[str, tuple[Path, str]]) -> Self:
        """Add small copies of pictures that open the large ones: relative address -> file, words below it."""
        items = "".join(
            f'<a href="{quote(href)}"><img alt="" src="{small_picture(file, THUMBNAIL_PX, 50)}">'
            f"<span>{escape(words)}</span></a>\n"
            for href, (file, words) in pictures.items()
        )
        self._body.append(f'<div class="thumbnails">\n{items}</div>')
        return self

    def table(
        self,
        rows: pd.DataFrame | Sequence[Mapping[str, Any]],
        caption: str,
        units: Mapping[str, str] | None = None,
        *,
        digits: int = 4,
    ) -> Self:
        """Add a table; one without a row is a sentence.

        Parameters
        ----------
        rows : a table, whose index is not shown, or rows by the words of the columns.
        caption : stands above the table.
        units : column -> unit, shown in its head.
        digits : significant digits of numbers with a fraction: of the largest in a column with a unit, whose
            numbers have equal decimals; elsewhere of each.

        Raises
        ------
        InputError : a unit for a column that is not there.
        """
        frame = pd.DataFrame(rows)
        unknown = [name for name in units or {} if name not in frame.columns]
        if unknown:
            raise InputError(f"units for columns {unknown}", expected=f"columns {list(frame.columns)}")
        if frame.empty:
            return self.text(f"{caption.rstrip('.')}: none.")
        numeric = {name: pd.api.types.is_numeric_dtype(frame[name]) for name in frame.columns}
        tags = {name: "th" if name else "td" for name in frame.columns}
        head = "".join(
            f"<{tags[name]}{_class(numeric[name])}>{escape(str(name))}"
            f"{_unit((units or {}).get(str(name), ''))}</{tags[name]}>"
            for name in frame.columns
        )
        decimals = {name: _decimals(frame[name], digits) for name in units or {} if numeric[name]}
        lines = "".join(
            "<tr>"
            + "".join(
                f"<td{_class(numeric[name])}>{escape(_cell(value, digits, decimals.get(str(name))))}</td>"
                for name, value in zip(frame.columns, row, strict=True)
            )
            + "</tr>\n"
            for row in frame.itertuples(index=False, name=None)
        )
        self._body.append(
            f'<div class="scroll" tabindex="0" role="region" aria-label="{escape(caption)}">'
            f"<table><caption>{escape(caption)}</caption>\n"
            f"<thead><tr>{head}</tr></thead>\n<tbody>\n{lines}</tbody></table></div>"
        )
        return self

    def html(self, home: str = "") -> str:
        """The page as text.

        Parameters
        ----------
        home : relative address of the front page that it leads back to, if there is one.
        """
        listed = [each for each in self._contents if not self._folded or not each[0].startswith("#")]
        contents = "".join(
            f'<li><a href="{quote(address, safe="/#")}">{escape(words)}</a></li>' for address, words in listed
        )
        nav = f"<nav><ul>{contents}</ul></nav>\n" if len(listed) > 1 - self._folded else ""
        body = "\n".join(self._folds() if self._folded else self._body)
        back = BACK.format(quote(home)) if home else ""
        words = re.sub(r"<[^>]*>", " ", self._lead + body)
        body += "".join(
            f"\n<p><small>{name}: {escape(source)}</small></p>"
            for name, source in SOURCES.items()
            if re.search(rf"\b{name}\b(?:(?<=P\d)|(?= (?:\d|Table|Fig)))", words)
        )
        return (
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
            '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
            f"<title>{escape(self.title)}</title>\n<style>{STYLE}</style>\n</head>\n<body>\n<main>\n{back}"
            f"<h1>{escape(self.title)}</h1>\n{self._lead}{nav}{body}\n</main>\n</body>\n</html>\n"
        )

    def _folds(self) -> list[str]:
        """The first figure and the first table, and each section below a line to click."""
        body = list(self._body)
        shown = [next((each for each in body if each.startswith(tag)), "") for tag in (_FIGURE, _TABLE)]
        for each in filter(None, shown):
            body.remove(each)
        begins = [k for k, each in enumerate(body) if each.startswith("<h2 ")]
        parts = [*body[: begins[0] if begins else len(body)], *filter(None, shown)]
        for k, end in pairwise([*begins, len(body)]):
            if end > k + 1:
                # browsers open what is folded where an address leads into it
                heading, anchor = re.sub("<[^>]*>", "", body[k]), body[k].split('"')[1]
                within = "\n".join([f'<span id="{anchor}"></span>', *body[k + 1 : end]])
                parts.append(f"<details><summary><h2>{heading}</h2></summary>{within}</details>")
        return parts

    def write(self, path: Path) -> None:
        """Write the page; the same content gives the same bytes."""
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(self.html(front_page_of(path)), encoding="utf-8")


_FIGURE, _TABLE = "<figure>", '<div class="scroll"'
BACK: Final = '<p class="back"><a href="{}">← Front page of the survey</a></p>\n'
"""Link of every page of a campaign to its front page."""


def front_page_of(page: Path) -> str:
    """Relative address of the front page of the campaign among whose results a page will stand; "": none.

    Examples
    --------
    >>> front_page_of(Path("results/tiny/accuracy/index.html"))
    '../index.html'
    >>> front_page_of(Path("results/tiny/index.html"))
    ''
    """
    folder = final_path(page).parent
    depth = next((k for k, parent in enumerate(folder.parents) if parent.name == "results"), 0)
    return f"{'../' * depth}index.html" if depth else ""


def findings_html(findings: Sequence[Finding]) -> str:
    """The few numbers at the head of a page as cards, each with its verdict."""
    rows = ""
    for f in findings:
        texts = (f.quantity, f.value, f.verdict)
        quantity, value, verdict = (_BEFORE_UNIT.sub("\N{NO-BREAK SPACE}", escape(each)) for each in texts)
        value = f'<a href="{quote(f.href, safe="/#")}">{value}</a>' if f.href else value
        looks = [tone for words, tone in TONES.items() if f.verdict.endswith(words)]
        looks += ["long"] * (len(f.value) > _LONG_VALUE)
        cells = "".join(f"<td>{each}</td>" for each in (quantity, value, verdict))
        rows += f'<tr class="{" ".join(looks)}">{cells}</tr>\n'
    head = "<tr><th>quantity</th><th>value</th><th>verdict</th></tr>"
    return f'<table class="findings">{head}\n{rows}</table>\n' if rows else ""


_BEFORE_UNIT: Final = re.compile(r"(?<=\d) (?=(?:%|°|[cm]?m[²³]?|m?s)(?![\w]))")
"""A space that is no end of a line."""
_FINDING: Final = re.compile(r"<tr[^>]*>" + "<td>(?:<a[^>]*>)?(.*?)(?:</a>)?</td>" * 3 + "</tr>")


def findings_of(page: str) -> list[Finding]:
    """The findings at the head of a page that was written, without their addresses.

    Examples
    --------
    >>> findings_of(Page("Bed", "", [Finding("RMSE & n", "5 cm, 4", "consistent")]).html())
    [Finding(quantity='RMSE & n', value='5 cm, 4', verdict='consistent', href='')]
    """
    _, _, rest = page.partition('<table class="findings">')
    table = rest.partition("</table>")[0].replace("\N{NO-BREAK SPACE}", " ")
    return [Finding(*map(unescape, cells)) for cells in _FINDING.findall(table)]


def small_picture(file: Path, width_px: int, quality: int) -> str:
    """A picture reduced to that width as an address that holds it, as WebP of that quality, 0 to 100."""
    memory = io.BytesIO()
    with Image.open(file) as picture:
        small = picture.convert("RGB")
        small.thumbnail((width_px, 2 * width_px), Image.Resampling.LANCZOS)
        small.save(memory, "WEBP", quality=quality, method=6)
    return data_address(memory.getvalue(), "webp")


def data_address(picture: bytes, kind: str) -> str:
    """An address that holds a picture itself."""
    return f"data:image/{kind};base64,{base64.b64encode(picture).decode()}"


def escape(words: str) -> str:
    """Words as HTML; a number that is none stands as a dash."""
    return escaped(dashed(words))


def _png(picture: Figure | Path, dpi: int) -> bytes:
    if isinstance(picture, Figure):
        memory = io.BytesIO()
        save(picture, memory, dpi=dpi)
        return memory.getvalue()
    if not picture.is_file():
        raise InputError("file not found", expected="a PNG picture", where=picture)
    data = picture.read_bytes()
    if not data.startswith(PNG_SIGNATURE):
        raise InputError("not a PNG file", expected="a picture that `save` wrote as .png", where=picture)
    return data


def _class(numeric: bool) -> str:
    return ' class="number"' if numeric else ""


def _unit(unit: str) -> str:
    return f' <span class="unit">/ {escape(unit)}</span>' if unit else ""


def _decimals(column: pd.Series, digits: int) -> int | None:
    """Decimals that give the largest number of a column so many significant digits; None: there is none."""
    sizes = column.abs().astype(float)
    sizes = sizes[sizes < math.inf]
    largest = sizes.max()
    if not largest > NOTHING:
        return None
    decimals = max(digits - 1 - math.floor(math.log10(largest)), 0)
    while decimals and (sizes.round(decimals) == sizes.round(decimals - 1)).all():
        decimals -= 1  # a nought that ends all of them
    return decimals


def _cell(value: Any, digits: int, decimals: int | None) -> str:
    """A value as people write it: no ``nan``, thousands apart, as many digits as asked for."""
    if value is None or value is pd.NaT or value is pd.NA:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int):
        return count(value)
    if isinstance(value, float):
        return number(value, digits, decimals)
    return str(value)
