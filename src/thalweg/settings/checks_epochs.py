"""Do the epochs of a campaign belong together: each a survey or files with a date, in the order of time?"""

import datetime as dt
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from thalweg.core import Key, Mistake
from thalweg.settings.checks_files import check_file, no_match, no_path
from thalweg.settings.checks_place import check_crs, parse_crs
from thalweg.settings.messages import expand, mistake
from thalweg.settings.sections import CLOUD_ENDINGS, DSM_ENDINGS, TEXT_ENDINGS, Epoch

_SOURCES: Final = ("campaign", "clouds", "dsm")
_OF_CAMPAIGNS: Final = ("chain", "surface")
_OF_FILES: Final = ("name", "date_utc", "crs", "sigma_m", "sigma_common_m", "nodata", "leave_out")
"""``correlation_m`` also belongs to the bed of a campaign, whose kriging gives the sigmas."""


def check_epochs(
    raw: object, identity: Mapping[str, Any], change: Mapping[str, Any], folder: Path
) -> Iterator[Mistake]:
    """Mistakes in the section ``epochs``, without the files of other campaigns.

    Parameters
    ----------
    raw : the section as written.
    identity : the section ``campaign`` as written; change: the section ``deformation``.
    folder : of the campaign file.
    """
    entries = [each if isinstance(each, dict) else {} for each in raw] if isinstance(raw, list) else []
    others = {path.stem for path in folder.glob("*.yaml")}
    named: list[object] = []
    files: dict[Path, int] = {}
    for i, each in enumerate(entries):
        where: tuple[Key, ...] = ("epochs", i)
        given = [key for key in _SOURCES if each.get(key)]
        if len(given) != 1:
            yield mistake(
                where,
                " and ".join(given) + " in one epoch" if given else "neither campaign nor clouds nor dsm",
                "exactly one of them",
                "Name a campaign of this folder, or files of a cloud (clouds) or a surface model (dsm)",
            )
            continue
        yield from _check_keys(each, given[0], where)
        if given[0] == "campaign":
            name = each["campaign"]
            if name in named or name == identity.get("id"):
                yield mistake(
                    (*where, "campaign"),
                    f"{name!r} " + ("a second time" if name in named else "is this campaign itself"),
                    "each survey once, in the order of time",
                    "Name the campaign of another survey",
                )
            named.append(name)
            continue
        name = each.get("name") or Epoch().called(i)
        if name in named or name in others:
            yield mistake(
                (*where, "name") if "name" in each else where,
                f"the name {name!r} " + ("a second time" if name in named else "is that of a campaign"),
                "a name of its own for each epoch",
                "Write another name",
            )
        named.append(name)
        yield from _check_statements(each, given[0], where)
        yield from _check_files(each, given[0], where, folder, files)
        yield from check_crs(each.get("crs"), identity.get("origin"), (*where, "crs"))
    yield from _check_heights(entries)
    yield from _check_stable(change.get("stable"), folder)


def _check_stable(stable: object, folder: Path) -> Iterator[Mistake]:
    """A file of stable ground is there."""
    where: tuple[Key, ...] = ("deformation", "stable")
    if stable == "CHANGE":
        yield mistake(
            where,
            "not filled in yet",
            "ground that did not move between the epochs: a file of polygons, lines or points",
            "Draw roads, roofs, rock in a GIS, in three and more areas that lie apart, and name the "
            "file; null where there is none: nothing is taken off then",
        )
    elif isinstance(stable, str):
        name = stable.partition("?")[0]
        matches = [Path(path) for path in expand(name, folder)]
        if not matches:
            yield no_match(where, name, folder)
        for path in matches:
            yield from check_file(where, name, path)


def _check_keys(each: Mapping[str, Any], source: str, where: tuple[Key, ...]) -> Iterator[Mistake]:
    """Keys of files beside a campaign, and the other way round."""
    of_campaign = source == "campaign"
    keys = [*_OF_FILES, *([] if each.get("surface") == "bed" else ["correlation_m"])]
    for key in keys if of_campaign else _OF_CAMPAIGNS:
        if key in each:
            yield mistake(
                (*where, key),
                f"{key} beside {source}",
                "keys of campaigns (chain, surface) or of files (date_utc, crs, sigma_m, ...)",
                "Remove it: the survey's own campaign states that" if of_campaign else "Remove it",
            )


def _check_statements(each: Mapping[str, Any], source: str, where: tuple[Key, ...]) -> Iterator[Mistake]:
    """A date, and both or neither of sigma and correlation length."""
    if each.get("date_utc") is None:
        yield mistake(
            where,
            "files without a date",
            "date_utc: the day of the survey, such as 2019-03-13, or its UTC time",
            "Write date_utc; rates of change and the order of epochs rest on it",
        )
    sigma, correlation = each.get("sigma_m"), each.get("correlation_m")
    if sigma is not None and correlation is None:
        yield mistake(
            (*where, "sigma_m"),
            "sigma_m without correlation_m",
            "the distance at which the correlation of these errors is 1/e",
            "Write correlation_m: 0 for independent points, tens of metres for image blocks, the length "
            "of a strip for scanners that move",
        )
    if sigma is None and correlation is not None and source == "clouds":
        yield mistake(
            (*where, "correlation_m"),
            "correlation_m without sigma_m",
            "both, or neither",
            "Write sigma_m, the standard deviation that neighbouring points share",
        )


def _check_files(
    each: Mapping[str, Any], source: str, where: tuple[Key, ...], folder: Path, before: dict[Path, int]
) -> Iterator[Mistake]:
    """Files are there, hold something, have an ending that is read, and belong to one epoch."""
    from thalweg.core.values import VECTOR_ENDINGS

    listed: list[tuple[tuple[Key, ...], object, tuple[str, ...]]] = []
    if source == "clouds" and isinstance(each["clouds"], list):
        endings: tuple[str, ...] = (*CLOUD_ENDINGS, *TEXT_ENDINGS)
        listed += [((*where, "clouds", k), text, endings) for k, text in enumerate(each["clouds"])]
    elif source == "dsm":
        listed.append(((*where, "dsm"), each["dsm"], DSM_ENDINGS))
    masks = each.get("leave_out")
    for k, text in enumerate(masks if isinstance(masks, list) else []):
        listed.append(((*where, "leave_out", k), text, VECTOR_ENDINGS))
    for place, text, endings in listed:
        if not isinstance(text, str):
            continue
        name = text.partition("?")[0] if endings == VECTOR_ENDINGS else text
        if (wrong_name := no_path(place, name, folder)) is not None:
            yield wrong_name
            continue
        matches = [Path(path) for path in expand(name, folder)]
        if not matches:
            yield no_match(place, name, folder)
        for path in matches:
            wrong = list(check_file(place, name, path))
            yield from wrong
            if wrong:
                continue
            if path.suffix.lower() not in endings:
                yield mistake(
                    place,
                    f"{path.name}: files that end in {path.suffix or 'nothing'} are not read here",
                    ", ".join(endings),
                    "Export it as one of these; surface models stand under dsm, points under clouds",
                )
            elif endings != VECTOR_ENDINGS:
                first = before.setdefault(path.resolve(), int(str(where[1])))
                if first != where[1]:
                    yield mistake(
                        place,
                        f"{path.name} is already the surface of epoch {first + 1}",
                        "files of its own for each epoch",
                        "Name the files of the other survey",
                    )


def _check_heights(entries: Sequence[Mapping[str, Any]]) -> Iterator[Mistake]:
    """One system of heights: ellipsoidal for surveys of campaigns, what ``crs`` states for files."""
    first: tuple[str, str] | None = None
    for i, each in enumerate(entries):
        stated = each.get("crs")
        crs = parse_crs(stated.strip()) if isinstance(stated, str) else None
        if each.get("campaign"):
            heights = "ellipsoidal"
        elif crs is None or isinstance(crs, str) or not crs.is_compound:
            continue  # of the file, or ellipsoidal: known when it is read
        else:
            heights = crs.sub_crs_list[1].name
        words = f"epoch {i + 1} ({each.get('campaign') or stated})"
        if first is not None and heights != first[1]:
            yield mistake(
                ("epochs", i, "campaign" if each.get("campaign") else "crs"),
                f"{words} has heights '{heights}', {first[0]} '{first[1]}'",
                "one system of heights for all epochs",
                "Transform the heights of the files, to ellipsoidal ones where a campaign is among the "
                "epochs",
            )
        first = first or (words, heights)


def check_dates(epochs: Sequence[Epoch], starts: Mapping[str, dt.datetime]) -> Iterator[Mistake]:
    """Epochs come in the order of time, as far as their times are known before anything is read.

    Parameters
    ----------
    epochs : the section.
    starts : start of those campaigns that state it, a twin's.
    """
    before: tuple[int, dt.datetime] | None = None
    for i, epoch in enumerate(epochs):
        moment = epoch.moment_utc if epoch.of_files else starts.get(epoch.campaign or "")
        if moment is None:
            continue
        if before is not None and moment <= before[1]:
            same = moment == before[1]
            yield mistake(
                ("epochs", i, "date_utc" if epoch.of_files else "campaign"),
                f"{moment:%Y-%m-%d %H:%M} UTC, "
                + (f"the time of epoch {before[0] + 1} too" if same else f"before epoch {before[0] + 1}"),
                "epochs in the order of time",
                "Correct one of the dates; two surveys of a day need their times, and one is one epoch"
                if same
                else "Change the order of the epochs, or correct the date",
            )
        before = (i, moment)
