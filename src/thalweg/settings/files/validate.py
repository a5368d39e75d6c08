"""From the data of a campaign file to a `Campaign`, with all mistakes collected first."""

import copy
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from thalweg.core.mistakes import Key, Mistake
from thalweg.core.yaml_lines import Document
from thalweg.settings.base.mounts import is_calibration_path
from thalweg.settings.campaign import Campaign
from thalweg.settings.checks.campaign import Parts, domain_mistakes
from thalweg.settings.messages.messages import mistake_of, show
from thalweg.settings.messages.paths import anchor
from thalweg.settings.sections.logs import Logs


def validate(document: Document, path: Path) -> tuple[Campaign | None, list[Mistake]]:
    """Check a document against the models and the domain rules.

    Parameters
    ----------
    document : what `read_yaml` gave.
    path : the campaign file; paths of logs are relative to its folder.

    Returns
    -------
    campaign : None if there are mistakes.
    mistakes : all of them, in the order of the file.
    """
    found = list(document.mistakes)
    campaign: Campaign | None = None
    data = document.data
    if isinstance(data, dict):
        campaign, errors, parts = _validate_models(data, path)
        domain, files = domain_mistakes(parts)
        found += errors + domain
        if campaign is not None and campaign.logs is not None:
            campaign = campaign.model_copy(update={"logs": campaign.logs.with_files(files)})
    elif not found:
        found.append(
            Mistake(
                found="the file is empty" if data is None else f"found {show(data)}",
                expected="a campaign: sections with keys",
                cure="Make a campaign file with `thalweg new-campaign`",
            )
        )
    unique = list(dict.fromkeys(_place(mistake, document, path) for mistake in found))
    unique.sort(key=lambda m: m.line)
    return (None if unique else _anchored(campaign, path)), unique


def _anchored(campaign: Campaign | None, path: Path) -> Campaign | None:
    """The campaign with the absolute paths of the files that its sections beside the logs name."""
    if campaign is None:
        return None
    chosen = campaign.mounts.calibration
    if chosen is not None and is_calibration_path(chosen):
        mounts = campaign.mounts.model_copy(update={"calibration": str(anchor(chosen, path.parent))})
        campaign = campaign.model_copy(update={"mounts": mounts})
    interior = campaign.calibration.boat_camera.interior
    if interior is not None:
        update = {"interior": str(anchor(interior, path.parent))}
        camera = campaign.calibration.boat_camera.model_copy(update=update)
        section = campaign.calibration.model_copy(update={"boat_camera": camera})
        campaign = campaign.model_copy(update={"calibration": section})
    return campaign


def _place(mistake: Mistake, document: Document, path: Path) -> Mistake:
    line = mistake.line or (document.line(mistake.path) if document.lines else 0)
    return replace(mistake, line=line, file=path)


def _validate_models(data: dict[str, Any], path: Path) -> tuple[Campaign | None, list[Mistake], Parts]:
    try:
        campaign = _from_json(TypeAdapter(Campaign), data)
    except ValidationError as error:
        details = error.errors(include_url=False)
        # A tuple of three without its last two is two findings of pydantic, but one mistake.
        mistakes = list(dict.fromkeys(mistake_of(detail) for detail in details))
        sections = _partial_sections(data, [tuple(detail["loc"]) for detail in details])
        return None, mistakes, Parts(path=path, data=data, **sections)
    sections = {name: getattr(campaign, name) for name in _SECTIONS}
    return campaign, [], Parts(path=path, data=data, **sections)


_SECTIONS = ("logs", "lidar", "mounts", "orientation", "georeferencing", "accuracy")


def _from_json(adapter: TypeAdapter[Any], data: Any) -> Any:
    # Strict JSON mode takes lists for tuples and text for dates, but no text or yes/no for numbers.
    return adapter.validate_json(json.dumps(data, default=str), strict=True)


def _partial_sections(data: dict[str, Any], locs: list[tuple[Key, ...]]) -> dict[str, Any]:
    """Sections without their faulty values, so that the domain checks still see the rest."""
    pruned = copy.deepcopy(data)
    for loc in locs:
        _remove(pruned, loc)
    sections: dict[str, Any] = {}
    for name in _SECTIONS:
        field = Campaign.model_fields[name]
        if pruned.get(name) is None:
            sections[name] = field.get_default(call_default_factory=True)
            continue
        try:
            kind: Any = Logs if name == "logs" else field.annotation
            sections[name] = _from_json(TypeAdapter(kind), pruned[name])
        except ValidationError:
            sections[name] = None
    return sections


def _remove(data: Any, loc: tuple[Key, ...]) -> None:
    for key in loc[:-1]:
        if isinstance(data, dict) and isinstance(data.get(key), dict):
            data = data[key]
        elif isinstance(data, dict):
            data.pop(key, None)
            return
        else:
            return
    if isinstance(data, dict) and loc:
        data.pop(loc[-1], None)
