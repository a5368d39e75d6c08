"""Load campaign files: one, or those that ``config.yaml`` or the command line choose."""

import copy
import datetime as dt
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from pydantic import TypeAdapter, ValidationError

from thalweg.core import Document, Key, Mistake, read_yaml
from thalweg.settings.campaign import Campaign
from thalweg.settings.checks_campaign import Parts, domain_mistakes
from thalweg.settings.checks_epochs import check_dates
from thalweg.settings.checks_place import SETTING
from thalweg.settings.drawn import with_drawn
from thalweg.settings.messages import CampaignError, anchor, expand, mistake, mistake_of, nearest, show
from thalweg.settings.sections import Epoch, Logs, Section, is_calibration_path

SectionT = TypeVar("SectionT", bound=Section)

# ---------------------------------------------------------------- from the data of a campaign file to a
# `Campaign`, with all mistakes collected first


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
        data, drawn = with_drawn(data, path.parent)
        found += drawn
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

    def absolute(text: object) -> object:
        """A path from the folder of the campaign file; what is no text stays."""
        return str(anchor(text, path.parent)) if isinstance(text, str) else text

    def named(text: object) -> object:
        """The same for a calibration that is named by a file; the id of a campaign stays."""
        return absolute(text) if isinstance(text, str) and is_calibration_path(text) else text

    def each(epochs: list[Epoch]) -> list[Epoch]:
        """The same for the files of all epochs."""
        return [_anchored_epoch(epoch, path.parent) for epoch in epochs]

    campaign = _changed(campaign, named, "mounts", "calibration")
    campaign = _changed(campaign, absolute, "calibration", "boat_camera", "interior")
    if campaign.epochs is None:
        return campaign
    return _changed(_changed(campaign, each, "epochs"), absolute, "deformation", "stable")


def _changed(section: SectionT, change: Callable[[Any], object], key: str, *below: str) -> SectionT:
    """A section with one of its values, or of those below, changed."""
    value = getattr(section, key)
    new = _changed(value, change, *below) if below else change(value)
    return section if new == value else section.model_copy(update={key: new})


def _anchored_epoch(epoch: Epoch, folder: Path) -> Epoch:
    """An epoch with the absolute paths of its files, patterns replaced by what matches."""
    return epoch.model_copy(
        update={
            "clouds": [str(path) for text in epoch.clouds for path in expand(text, folder)],
            "dsm": None if epoch.dsm is None else str(anchor(epoch.dsm, folder)),
            "leave_out": [str(anchor(text, folder)) for text in epoch.leave_out],
        }
    )


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


# ---------------------------------------------------------------- load


def load_campaign(path: Path | str) -> Campaign:
    """Load and check one campaign file.

    Parameters
    ----------
    path : YAML file. Paths of logs in it are relative to its folder.

    Returns
    -------
    Campaign
        With absolute paths of all logs; patterns are replaced by the files that match, sorted by name.

    Raises
    ------
    CampaignError : a `ConfigError` that lists every mistake: file, line, path, what was found, what was
        expected, and the cure.
    """
    campaign, mistakes = check_campaign(Path(path))
    if campaign is None:
        raise CampaignError(mistakes)
    return campaign


def check_campaign(path: Path, folder: Path | None = None) -> tuple[Campaign | None, list[Mistake]]:
    """The campaign of a file, or None and all its mistakes.

    Parameters
    ----------
    path : YAML file.
    folder : folder of campaign files, in which the campaign that ``mounts.calibration`` names is looked up;
        None: it is not.
    """
    if not path.exists():
        return None, [Mistake(found="no such file", cure=_nearest_yaml(path), file=path)]
    document = read_yaml(path)
    campaign, mistakes = validate(document, path)
    if folder is not None and isinstance(document.data, dict):
        section = document.data.get("mounts")
        chosen = section.get("calibration") if isinstance(section, dict) else None
        calibrations, found = named_calibration(chosen, folder, (path.stem,))
        if campaign is not None:
            found = [*found, *_uncalibrated_rig(campaign, calibrations)]
        placed = [_placed(m, path) for m in found]
        own = [m for m in placed if m.file == path]
        mistakes = sorted([*mistakes, *own], key=lambda m: m.line)
        mistakes += [m for m in placed if m.file != path]
        if campaign is not None:
            wrong = named_epochs(campaign, folder)[1]
            mistakes += [m if m.file is not None else _place(m, document, path) for m in wrong]
    return (None if mistakes else campaign), mistakes


def _nearest_yaml(path: Path) -> str:
    from thalweg.settings.messages import nearest_names  # imports glob and difflib only where needed

    names = nearest_names(path)
    if names:
        return f"Did you mean {path.parent / names[0]}?"
    return "Check the path, or make a campaign with `thalweg new-campaign`"


def load_campaigns(choice: object, folder: Path) -> dict[str, Campaign]:
    """Load the chosen campaigns.

    Parameters
    ----------
    choice : an id (a file ``<id>.yaml`` in ``folder``), a path to a YAML file, a pattern of paths such as
        ``survey_2026/*``, or a list of them.
    folder : folder of campaign files.

    Returns
    -------
    dict
        By id, in the order of the choice.

    Raises
    ------
    CampaignError : lists the mistakes of all chosen files and of the calibration campaigns that they name,
        unknown ids, and ids that stand twice.
    """
    mistakes: list[Mistake] = []
    entries: list[object] = []
    for entry in choice if isinstance(choice, list | tuple) else [choice]:
        matching = _matching(entry, folder) if isinstance(entry, str) and set(entry) & set("*?[") else [entry]
        mistakes += [each for each in matching if isinstance(each, Mistake)]
        entries += [each for each in matching if not isinstance(each, Mistake)]
    campaigns: dict[str, Campaign] = {}
    files: dict[str, Path] = {}
    if not entries and not mistakes:
        mistakes.append(_no_choice(choice, folder))
    for entry in entries:
        path = campaign_path(entry, folder)
        if isinstance(path, Mistake):
            mistakes.append(path)
            continue
        campaign, found = check_campaign(path, folder if folder.is_dir() else path.parent)
        mistakes += found
        if campaign is None:
            continue
        if campaign.id in campaigns:
            mistakes.append(_twice(campaign.id, files[campaign.id], path))
        campaigns.setdefault(campaign.id, campaign)
        files.setdefault(campaign.id, path)
    if mistakes:
        raise CampaignError(list(dict.fromkeys(mistakes)))
    return campaigns


def with_calibrations(campaigns: dict[str, Campaign], folder: Path) -> dict[str, Campaign]:
    """Add the calibration campaigns that ``mounts.calibration`` of the given ones names.

    Parameters
    ----------
    campaigns : by id.
    folder : folder of campaign files.

    Returns
    -------
    dict
        The calibrations first, and before them those that they name themselves.

    Raises
    ------
    CampaignError : lists calibrations that do not exist or are none.
    """
    needed: dict[str, Campaign] = {}
    mistakes: list[Mistake] = []
    for name, campaign in campaigns.items():
        found, wrong = named_calibration(campaign.mounts.calibration, folder, (name,))
        mistakes += [_placed(m, folder / f"{name}.yaml") for m in wrong]
        epochs, wrong = named_epochs(campaign, folder)
        basin, wrong_basin = named_basin(campaign.light_sheet.sensor, folder)
        needed |= {one.id: one for one in (*found, *epochs, *basin)}
        mistakes += [replace(m, file=m.file or folder / f"{name}.yaml") for m in (*wrong, *wrong_basin)]
    if mistakes:
        raise CampaignError(list(dict.fromkeys(mistakes)))
    return {**needed, **campaigns}


def named_epochs(campaign: Campaign, folder: Path) -> tuple[list[Campaign], list[Mistake]]:
    """The campaigns whose clouds a campaign of epochs compares, behind the calibrations that they name.

    Returns
    -------
    campaigns : in the order of the epochs.
    mistakes : in the section `epochs` (without file), and in the files of the campaigns.
    """
    found: list[Campaign] = []
    mistakes: list[Mistake] = []
    starts: dict[str, dt.datetime] = {}
    for i, epoch in enumerate(campaign.epochs or []):
        if epoch.campaign is None:
            continue
        path = folder / f"{epoch.campaign}.yaml"
        survey, wrong = check_campaign(path) if path.is_file() else (None, [])
        if survey is None or survey.is_change or survey.is_calibration or survey.is_basin:
            known = nearest(epoch.campaign, campaign_ids(folder))
            words = (
                f"the campaign {epoch.campaign!r} has mistakes of its own"
                if wrong
                else f"there is no campaign {epoch.campaign!r} in {folder}"
                if survey is None
                else f"the campaign {epoch.campaign!r} surveys no river"
            )
            cure = f"Correct {path}" if wrong else f"Did you mean {known}?" if known else "Name a survey"
            mistakes += [
                mistake(
                    ("epochs", i, "campaign"),
                    words,
                    "a campaign with twin or logs of a survey of the bank",
                    cure,
                ),
                *wrong,
            ]
            continue
        if survey.twin is not None:
            starts[epoch.campaign] = dt.datetime.fromisoformat(survey.twin.start_utc)
        images = survey.twin.time_lapse if survey.twin else survey.log_files("time_lapse")
        bed, depths = epoch.surface == "bed", survey.twin or survey.log_files("depth")
        rows = (
            (
                epoch.chain in ("camera", "fused") and not images,
                "chain",
                f"chain {epoch.chain!r}, but {epoch.campaign!r} has no time-lapse images",
                "chain: ins",
                "Write chain: ins, or add the images to that campaign",
            ),
            (
                epoch.chain == "strips" and not (survey.strips.adjust or survey.strips.use),
                "chain",
                f"chain 'strips', but {epoch.campaign!r} adjusts no strips",
                "strips.adjust: true in that campaign",
                "Write strips: {adjust: true} there, or another chain here",
            ),
            (
                bed and not depths,
                "surface",
                f"surface 'bed', but {epoch.campaign!r} has no soundings",
                "surface: bank",
                "Remove the line, or add the log of the echo sounder to that campaign",
            ),
            (
                bed and epoch.correlation_m is None,
                "surface",
                "surface 'bed' without correlation_m",
                "the distance at which the correlation of errors of the bed is 1/e",
                "Write correlation_m, about half the distance of the lines of soundings",
            ),
            (
                survey.campaign.crs != campaign.campaign.crs,
                "campaign",
                f"{epoch.campaign!r} is in {survey.campaign.crs}, this campaign in {campaign.campaign.crs}",
                "one coordinate system for all epochs, with ellipsoidal heights",
                "Write the same campaign.crs in all of them",
            ),
        )
        refused = [mistake(("epochs", i, key), *words) for is_so, key, *words in rows if is_so][:1]
        if refused:
            mistakes += refused
            continue
        before, wrong = named_calibration(survey.mounts.calibration, folder, (survey.id,))
        mistakes += [_placed(m, path) for m in wrong]
        found += [*before, survey]
    mistakes += check_dates(campaign.epochs or [], starts)
    return found, mistakes


def named_basin(chosen: str | None, folder: Path) -> tuple[list[Campaign], list[Mistake]]:
    """The basin campaign that ``light_sheet.sensor`` names.

    Parameters
    ----------
    chosen : the setting.
    folder : folder of campaign files.

    Returns
    -------
    campaigns : one; none if nothing is named or there are mistakes.
    mistakes : in the setting (without file), and in the file of the basin.
    """
    if chosen is None:
        return [], []
    path = folder / f"{chosen}.yaml"
    campaign, wrong = check_campaign(path) if path.is_file() else (None, [])
    if campaign is not None and campaign.is_basin:
        return [campaign], []
    found = f"the campaign {chosen!r} has mistakes of its own" if wrong else f"no basin campaign {chosen!r}"
    own = mistake(
        "light_sheet.sensor",
        found,
        "a campaign of the sensor in a basin",
        f"Correct {path}" if wrong else f"Name one of the campaigns in {folder}",
    )
    return [], [own, *wrong]


def _uncalibrated_rig(campaign: Campaign, calibrations: Sequence[Campaign]) -> Iterator[Mistake]:
    """Files of a rig that the boat's calibration should have calibrated, and did not."""

    def rig(one: Campaign, *keys: str) -> bool:
        """Whether a campaign has these logs of a rig, or a twin that writes them."""
        given = one.logs.rig if one.logs is not None else None
        made = one.twin is not None and one.twin.dual_fisheye is not None
        return made or any(bool(getattr(given, key, None)) for key in keys)

    own = campaign.twin is None and rig(campaign, "field", "calibration")
    if campaign.is_calibration or not calibrations or own or not rig(campaign, "images"):
        return
    if not any(rig(one, "field", "calibration") for one in calibrations):
        yield mistake(
            SETTING,
            f"files of a rig, and the calibration {calibrations[-1].id} calibrates none",
            "a field of marks around the rig in it, or a calibration of the rig",
            "Record one there, or state logs.rig.calibration",
        )


def named_calibration(
    chosen: object, folder: Path, chain: tuple[str, ...]
) -> tuple[list[Campaign], list[Mistake]]:
    """The calibration campaign that ``mounts.calibration`` names, behind those that it names itself.

    Parameters
    ----------
    chosen : the setting; a path or what is no text is another check's.
    folder : folder of campaign files.
    chain : ids that led here, the last one holds the setting.

    Returns
    -------
    campaigns : empty if there are mistakes.
    mistakes : in the setting (without file), and in the files of the calibration campaigns.
    """
    if not isinstance(chosen, str) or not chosen or is_calibration_path(chosen) or chosen == chain[-1]:
        return [], []
    path = folder / f"{chosen}.yaml"
    if chosen in chain:
        circle = " -> ".join((*chain, chosen))
        return [], [_wrong_calibration(f"campaigns name each other in a circle: {circle}", folder)]
    if not path.is_file():
        near = nearest(chosen, campaign_ids(folder))
        found = f"there is no campaign {chosen!r} in {folder}"
        return [], [_wrong_calibration(found, folder, f"Did you mean {near}?" if near else "")]
    campaign, wrong = check_campaign(path)
    if campaign is None:
        own = _wrong_calibration(
            f"the campaign {chosen!r} has mistakes of its own", folder, f"Correct {path}"
        )
        return [], [own, *wrong]
    if not campaign.is_calibration:
        return [], [
            _wrong_calibration(f"the campaign {chosen!r} surveys a river, no calibration field", folder)
        ]
    if campaign.logs is not None and not (campaign.logs.lidar and campaign.logs.ins):
        found = f"the campaign {chosen!r} has no dynamic run (logs.lidar, logs.ins)"
        cure = "Without a run no sensor gets its place on the boat: record one, or name a calibration file"
        return [], [_wrong_calibration(found, folder, cure)]
    before, wrong = named_calibration(campaign.mounts.calibration, folder, (*chain, chosen))
    wrong = [_placed(m, path) for m in wrong]
    return ([] if wrong else [*before, campaign]), wrong


def _placed(mistake: Mistake, path: Path) -> Mistake:
    """The mistake in ``mounts.calibration`` of a file; one that has its file already is left."""
    if mistake.file is not None:
        return mistake
    return replace(mistake, line=read_yaml(path).line(SETTING) if path.is_file() else 0, file=path)


def _wrong_calibration(found: str, folder: Path, cure: str = "") -> Mistake:
    """A mistake in ``mounts.calibration``; the caller knows file and line."""
    known = [
        name
        for name in campaign_ids(folder)
        if (campaign := check_campaign(folder / f"{name}.yaml")[0]) is not None and campaign.is_calibration
    ]
    names = f" ({', '.join(known)})" if known else ""
    return mistake(
        SETTING,
        found,
        f"a calibration campaign{names}, or the path of a calibration file",
        cure or "Name a campaign with a calibration field, or the path of a calibration file",
    )


def _matching(pattern: str, folder: Path) -> list[str] | list[Mistake]:
    """Campaign files that a pattern names, here or in the folder of campaigns, by name."""
    words = pattern.strip()
    named = words if words.endswith((".yaml", ".yml", "*")) else f"{words}.yaml"
    for base in (Path(), folder):
        paths = (
            sorted(base.glob(named)) if not Path(named).is_absolute() else sorted(Path("/").glob(named[1:]))
        )
        files = [str(path) for path in paths if path.suffix in {".yaml", ".yml"} and path.is_file()]
        if files:
            return files
    return [
        mistake(
            "campaign",
            f"no campaign file matches {words!r}",
            f"files *.yaml here or in {folder}",
            "Correct the pattern; the shell must not see it: --config 'campaign=survey_2026/*'",
        )
    ]


def campaign_path(entry: object, folder: Path) -> Path | Mistake:
    """The file of an entry of ``campaign:``, or the mistake in it."""
    if not isinstance(entry, str) or not entry.strip():
        return _no_choice(entry, folder)
    text = entry.strip()
    if "/" in text or text.endswith((".yaml", ".yml")):
        path = Path(text).expanduser()
        return path if path.is_absolute() or path.exists() else _inside(path, folder)
    path = folder / f"{text}.yaml"
    if path.is_file():
        return path
    known = campaign_ids(folder)
    near = nearest(text, known)
    cure = f"Did you mean {near}? " if near else ""
    if "," in text:
        cure = f'Choose several with a list: --config campaign="[{text}]". '
    return mistake(
        "campaign",
        f"there is no campaign {text!r} in {folder}",
        f"one of {', '.join(known)}, or a path" if known else "a path to a campaign file",
        f"{cure}Make a new one with `thalweg new-campaign`",
    )


def campaign_ids(folder: Path) -> list[str]:
    """Ids of the campaign files in a folder, sorted."""
    return sorted(path.stem for path in folder.glob("*.yaml"))


def _inside(path: Path, folder: Path) -> Path:
    """A path given relative to the campaigns' folder, where it exists there; else the path itself."""
    return folder / path if (folder / path).exists() else path


def _no_choice(choice: object, folder: Path) -> Mistake:
    known = ", ".join(campaign_ids(folder))
    return mistake(
        "campaign",
        f"found {choice!r}",
        "the id of a campaign, a path to its file, or a list of them",
        f"Write for instance campaign: demo in config/config.yaml. Known ids: {known or 'none'}",
    )


def _twice(name: str, first: Path, second: Path) -> Mistake:
    same = first.resolve() == second.resolve()
    return mistake(
        "campaign",
        f"campaign {name!r} is chosen twice"
        if same
        else f"two files have the id {name!r}: {first} and {second}",
        "each id once",
        "Remove one of them from the list" if same else "Rename one file and its campaign.id",
    )
