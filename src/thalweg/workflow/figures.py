"""The table of all pictures, ``workflow/figures.yaml``, which rules, pages and documents are made from."""

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError

from thalweg.core import ROOT, ConfigError, Document, Mistake, read_yaml
from thalweg.settings import Campaign
from thalweg.workflow.campaign_files import CampaignFiles
from thalweg.workflow.codehash import SOURCE

Kind = Literal[
    "survey", "photographs", "fixed_camera", "cloud", "calibration", "basin", "scan", "change", "study"
]

_CALL = re.compile(r"=?(\w+)(?:\(([\w./{}]*)\))?")
"""A method of `CampaignFiles`, perhaps with an argument."""


def _listed(value: Any) -> Any:
    return value if isinstance(value, list | tuple) else [value]


class Figure(BaseModel):
    """A row of the table: a picture, what it is drawn from and where it is shown."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str = Field(pattern=r"^\w+$")
    kind: Kind
    shows: str
    draw: str | None = Field(None, pattern=r"^[\w.]+:\w+$")
    inputs: dict[str, str | list[str]] = {}
    settings: dict[str, str | float] = {}
    when: Annotated[list[str], BeforeValidator(_listed)] = []
    also: Annotated[list[Kind], BeforeValidator(_listed)] = []
    page: str | None = None
    category: str
    memory_mb: Annotated[list[float], BeforeValidator(_listed), Field(min_length=1, max_length=2)] = [2000]
    file: str | None = None
    caption: str
    caption_of_files: str | None = None

    @property
    def rule(self) -> str:
        """Name of its rule."""
        return f"plot_{self.name}"

    @property
    def owner(self) -> str:
        """Whose results it belongs to: a campaign by its wildcard, or the studies, which have none."""
        return "reproduction" if self.kind == "study" else "{campaign}"

    @property
    def path(self) -> str:
        """Its file, with wildcards."""
        return self._below(self.file or f"figures/{self.name}.png")

    def log(self, suffix: str = "png") -> str:
        """The log of the rule of a format, with wildcards."""
        place = self.owner if self.kind == "study" else f"{self.owner}/figures"
        path = f"logs/{place}/{self.rule}{'_{scan}' * (self.kind == 'scan')}.png"
        return f"{as_format(path, suffix).removesuffix('.png')}.log"

    def input_files(self, campaigns: Mapping[str, CampaignFiles]) -> dict[str, Any]:
        """Inputs by keyword: paths with wildcards, and functions of the wildcards."""

        def asked(text: str) -> Callable[[Any], Any]:
            """Input function: what a method of the campaign of the job answers."""
            if self.kind == "scan":
                return lambda wildcards: _ask(text, campaigns[wildcards.campaign], wildcards.scan)
            return lambda wildcards: _ask(text, campaigns[wildcards.campaign])

        found: dict[str, Any] = {}
        for key, value in self.inputs.items():
            if isinstance(value, str):
                found[key] = asked(value) if value.startswith("=") else self._below(value)
            else:
                found[key] = [self._below(path) for path in value]
        return found

    def params(self, campaigns: Mapping[str, CampaignFiles]) -> dict[str, Any]:
        """What it is drawn with beside its inputs by keyword: values, and functions of the wildcards."""

        def setting(key: str) -> Callable[[Any], Any]:
            """Params function: a value of the campaign of the job, or what a method of it answers."""
            if key.startswith("="):
                return lambda wildcards: _ask(key, campaigns[wildcards.campaign])
            return lambda wildcards: campaigns[wildcards.campaign].section(*key.split("."))

        if self.kind == "study":
            return {"dpi": 200, "titles": True, **self.settings}
        keys = {"title": "campaign.title", "dpi": "figures.dpi", "titles": "figures.titles", **self.settings}
        found = {name: setting(key) if isinstance(key, str) else key for name, key in keys.items()}
        found["twin"] = lambda wildcards: campaigns[wildcards.campaign].is_twin()
        return found | ({"scan": lambda wildcards: wildcards.scan} if self.kind == "scan" else {})

    def _below(self, path: str) -> str:
        if path.startswith("resources/"):
            return str(ROOT / path)
        return f"results/{self.owner}/{path}"


def as_format(path: str, suffix: str) -> str:
    """The file of a picture in another format.

    Examples
    --------
    >>> as_format("results/{campaign}/figures/map.png", "pdf")
    'results/{campaign}/figures/map.pdf'
    """
    return f"{path.removesuffix('.png')}.{suffix}"


def _ask(text: str, campaign: CampaignFiles, *scan: str) -> Any:
    """What a campaign answers to ``name`` or ``name(argument)``; a scan comes first."""
    match = _CALL.fullmatch(text)
    assert match is not None  # `_unknown` has seen it
    return getattr(campaign, match[1])(*scan, *([match[2]] if match[2] else []))


def _kind(campaign: CampaignFiles) -> Kind | None:
    """Which pictures a campaign has; none for a calibration by boards alone."""
    kind = campaign.campaign.kind
    return None if kind == "calibration" and not campaign.logs("field") else kind


@dataclass(frozen=True)
class Figures:
    """All rows, in their order."""

    rows: Sequence[Figure]

    def drawn(self) -> list[Figure]:
        """Those that have a rule of their own."""
        return [row for row in self.rows if row.draw is not None]

    def files(
        self, campaign: CampaignFiles, page: str | None = None, formats: Sequence[str] = ("png",)
    ) -> list[str]:
        """Pictures of a campaign, and then those of each scan; of one page, if it is named."""
        kind, rows = _kind(campaign), [row for row in self.rows if page in (None, row.page)]
        found = [(row, "") for row in rows if kind in (row.kind, *row.also)]
        if kind == "basin":
            scans = campaign.scan_names()
            found += [(row, scan) for scan in scans for row in rows if row.kind == "scan"]
        return [
            as_format(row.path, each).format(campaign=campaign.name, scan=scan)
            for row, scan in found
            if all(_ask(condition, campaign, *filter(None, [scan])) for condition in row.when)
            for each in formats
            if each == "png" or row.draw is not None
        ]

    def files_to_keep(self, campaign: CampaignFiles) -> list[str]:
        """Pictures of a campaign in the formats of its setting figures.formats."""
        chosen = campaign.section("figures", "formats")
        return self.files(campaign, formats=list(dict.fromkeys(["png", *chosen])))

    def captions(self, *pages: str, of_files: bool = False) -> dict[str, str]:
        """Captions of the pictures of pages by name; ``of_files``: no boat surveyed what they show."""
        return {
            row.name: (row.caption_of_files if of_files else None) or row.caption
            for row in self.rows
            if row.page in pages
        }


def read_figures(path: Path, *, source: Path = SOURCE) -> Figures:
    """Read the table and check it.

    Parameters
    ----------
    path : the table.
    source : folder of the packages.

    Raises
    ------
    ConfigError : all mistakes of the table, each with its line and cure.
    """
    document = read_yaml(path)
    rows, found = rows_of(document)
    for row in rows:
        found += _unknown(row, source)
    if found:
        placed = [replace(each, line=each.line or document.line(each.path), file=path) for each in found]
        text = "\n".join(str(each) for each in sorted(placed, key=lambda each: each.line))
        raise ConfigError(text.rstrip("."))
    return Figures(rows)


def rows_of(document: Document) -> tuple[list[Figure], list[Mistake]]:
    """Rows that are whole, and mistakes of the others."""
    rows, found = [], list(document.mistakes)
    groups = document.data if isinstance(document.data, dict) else {}
    named = [
        ((kind, name), keys)
        for kind, group in groups.items()
        for name, keys in (group.items() if isinstance(group, dict) else [("", group)])
    ]
    for path, keys in named:
        if not isinstance(keys, dict):
            cure = f"Write keys below it: {', '.join(_KEYS)}"
            found.append(Mistake(path=path, found=f"found {keys!r}", expected="a picture", cure=cure))
            continue
        try:
            text = json.dumps({**keys, "kind": path[0], "name": path[1]})
            rows.append(Figure.model_validate_json(text))
        except ValidationError as error:
            found += [_mistake(path, detail) for detail in error.errors(include_url=False)]
    return rows, found


def _mistake(path: tuple[str, ...], detail: Any) -> Mistake:
    key = str(detail["loc"][0])
    path = path[: ("kind", "name").index(key) + 1] if key in {"kind", "name"} else (*path, key)
    if detail["type"] == "missing":
        return Mistake(path=path, found="missing", cure=f"Add the line `{key}: …`")
    if detail["type"] == "extra_forbidden":
        return Mistake(path=path, found="unknown key", expected=f"one of {', '.join(_KEYS)}")
    return Mistake(path=path, found=f"found {detail['input']!r}: {detail['msg']}", cure="Correct the value")


_KEYS = [key for key in Figure.model_fields if key not in {"name", "kind"}]


def _is_setting(path: str) -> bool:
    """True if a campaign file can have a value at a path such as ``accuracy.sections``."""
    model: Any = Campaign
    for key in path.split("."):
        if key not in getattr(model, "model_fields", {}):
            return False
        hint = model.model_fields[key].annotation
        model = next((each for each in (hint, *get_args(hint)) if hasattr(each, "model_fields")), None)
    return True


def _unknown(row: Figure, source: Path) -> list[Mistake]:
    """Functions and settings of a row that nothing defines."""
    here, found = (row.kind, row.name), list[Mistake]()
    asked: list[tuple[tuple[str, ...], str]] = [(("when",), text) for text in row.when]
    for place, named in (("inputs", row.inputs), ("settings", row.settings)):
        for key, text in named.items():
            asked += [((place, key), text)] if isinstance(text, str) and text.startswith("=") else []
    for where, text in asked:
        match = _CALL.fullmatch(text)
        if row.kind == "study" or match is None or not callable(getattr(CampaignFiles, match[1], None)):
            cure = "Write it into thalweg.workflow.campaign_files, or correct the name"
            words = f"no method {text.lstrip('=')} of CampaignFiles"
            found.append(Mistake(path=(*here, *where), found=words, cure=cure))
    for key, value in row.settings.items():
        if isinstance(value, str) and not value.startswith("=") and not _is_setting(value):
            cure = "Write section.key as config/README.md has them"
            found.append(
                Mistake(path=(*here, "settings", key), found=f"no setting {value} of a campaign", cure=cure)
            )
    if row.draw is not None:
        module, name = row.draw.split(":")
        file = source.joinpath(*module.split(".")).with_suffix(".py")
        if not file.is_file():
            cure = "Correct the name of the module, or write it"
            found.append(Mistake(path=(*here, "draw"), found=f"no module {module}", cure=cure))
        elif not re.search(rf"(?m)^def {name}\(", file.read_text(encoding="utf-8")):
            cure = f"Write it there, or correct the name {name}"
            found.append(Mistake(path=(*here, "draw"), found=f"{module} defines no {name}", cure=cure))
    elif row.file is None:
        cure = "Add `draw: module:function`, or name the file that another rule makes"
        found.append(Mistake(path=here, found="neither draw nor file", cure=cure))
    return found
