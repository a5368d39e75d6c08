"""One page on what changed between epochs: the verdict first, then what it rests on, then its limits."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

from thalweg.core import InputError, read_json, read_table, utc_text_from_gps
from thalweg.deformation import CHANGES, CORE_POINTS, STATES, VISIBILITY
from thalweg.figures import Finding, Page, count, number
from thalweg.figures.accuracy import centimetres
from thalweg.figures.deformation.maps import NOT_SEEN, scene, signed

GROUPS_IN_WORDS: Final = {
    "position": "positions, time-correlated",
    "position, white": "positions, random",
    "attitude": "attitude",
    "mount, shift": "lever arm of the scanner",
    "mount, rotation": "mounting angles of the scanner",
    "stated": "stated of the files",
    "stated, common to all": "stated of the files, systematic",
    "not stated": "not stated",
    "smoothed trajectory": "poses of the smoothed trajectory",
    "images": "poses of the photographs",
    "times of images": "times of single photographs",
    "clock of the camera": "clock of the camera",
    "between the nodes": "INS between photographs or nodes",
}
DIFFERENCES: Final = (
    ("volume_m3", "volume", "m³"),
    ("sigma_m3", "sigma", "m³"),
    ("low_m3", "95 % from", "m³"),
    ("high_m3", "to", "m³"),
    ("area_m2", "area", "m²"),
)
CONTROL_IN_WORDS: Final = {
    "fdr": "of all core points that are called changed, at most {percent:g} % did not change (Benjamini and "
    "Hochberg)",
    "family": "the chance that a single unchanged core point anywhere is called changed is {percent:g} %",
    "none": "each unchanged core point is called changed with a chance of {percent:g} %",
}
MOTIONS: Final = {
    "east_m": "shift to the east",
    "north_m": "shift to the north",
    "up_m": "shift upward",
    "turn_east": "rotation about east",
    "turn_north": "rotation about north",
    "turn_up": "rotation about up",
}
TRUTH_IN_WORDS: Final = {
    "normalised_square_unchanged": "unchanged ground: mean of squared error over variance",
    "false_alarm_95": "unchanged ground: share beyond its level of detection (95 %)",
    "normalised_square_changed": "changed ground: mean of squared error over variance",
    "sensitivity_0.1_m": "share of changes of 10 cm and more that were called changes",
    "specificity": "share of unchanged ground that was called unchanged",
    "false_discovery": "false discovery rate",
    "net_volume_error_m3": "net volume: error, m³",
    "net_volume_error_over_sigma": "net volume: error over sigma",
    "largest_retreat_true_m": "largest retreat: true, m",
    "largest_retreat_measured_m": "largest retreat: measured, m",
    "unseen_called_change": "areas without data reported as change",
    "unseen_called_change_wrongly": "of these wrongly",
    "true_changes_seen": "true changes of 10 cm and more: share of their area that was measured",
    "true_changes_called": "of this the share that was called so, with the right sign",
    "height_normalised_square_unchanged": "heights of unchanged ground: mean of squared error over variance",
    "height_normalised_square_changed": "heights of changed ground: mean of squared error over variance",
    "plants_called_change": "share of plants reported as change",
    "things_called_change": "share of objects reported as change",
}
VOLUMES: Final = (
    ("volume_m3", "volume", "m³"),
    ("sigma_m3", "sigma", "m³"),
    ("low_m3", "95 % from", "m³"),
    ("high_m3", "to", "m³"),
    ("bias_m3", "bias", "m³"),
    ("area_m2", "area", "m²"),
    ("not_seen_m2", "no data", "m²"),
)
PATCHES: Final = (
    ("area_m2", "area", "m²"),
    ("volume_m3", "volume", "m³"),
    ("mean_distance_m", "mean distance", "m"),
    ("largest_distance_m", "largest distance", "m"),
    ("east_m", "east", "m"),
    ("north_m", "north", "m"),
    ("up_m", "height", "m"),
)
_ENU: Final = ("east", "north", "up")
MOST_PATCHES: Final = 15
"""Patches of a pair that the page lists."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PairFacts:
    """What was found out about a pair of epochs.

    Attributes
    ----------
    name : such as ``1-2``.
    changes, visibility : core points, and what each epoch saw of them.
    area_m2 : that each core point stands for.
    control : how significance is controlled, ``changes_<pair>.json``.
    registration : ``registration_<pair>.json``.
    volumes, patches : tables ``volumes_<pair>.csv`` and ``patches_<pair>.csv``.
    difference : table ``dod_<pair>.csv``, volumes of the difference of heights.
    """

    name: str
    changes: pd.DataFrame
    visibility: pd.DataFrame
    area_m2: pd.Series
    control: Mapping[str, Any]
    registration: Mapping[str, Any]
    volumes: pd.DataFrame
    patches: pd.DataFrame
    difference: pd.DataFrame

    @property
    def words(self) -> str:
        """``Epochs 1 to 2``."""
        return f"Epochs {self.name.replace('-', ' to ')}"

    def volume(self, what: str) -> Mapping[str, float]:
        """Row of the volumes.

        Raises
        ------
        InputError : there is no such row.
        """
        rows = self.volumes[self.volumes["what"] == what]
        if len(rows) != 1:
            raise InputError(
                f"{len(rows)} rows '{what}' in the volumes of {self.name}", expected="one: a finished pair"
            )
        return {str(key): float(value) for key, value in rows.iloc[0].drop("what").items()}

    @property
    def heights(self) -> Mapping[str, float]:
        """Net volume of the difference of heights."""
        row = self.difference[self.difference["part"] == "net"].iloc[0]
        return {name: float(row[name]) for name, _, _ in DIFFERENCES}

    @property
    def sigma_known(self) -> bool:
        """Whether standard deviations of both epochs are stated, or estimated on drawn ground."""
        return self.registration.get("sigma") != "unknown"

    @property
    def unseen_m2(self) -> float:
        """Area that one epoch or both did not see."""
        return float(self.area_m2[self.changes["state"].isin(NOT_SEEN)].sum())


def read_pair_facts(
    changes: Sequence[Path],
    visibility: Sequence[Path],
    control: Sequence[Path],
    registrations: Sequence[Path],
    volumes: Sequence[Path],
    patches: Sequence[Path],
    differences: Sequence[Path],
    core_points: Path,
) -> list[PairFacts]:
    """Results of all pairs, from the files that `workflow/rules/deformation.smk` names.

    Raises
    ------
    InputError : a file is missing or of another kind.
    """
    area = read_table(core_points, CORE_POINTS)[0]["area_m2"]
    return [
        PairFacts(
            name=change.stem.rpartition("_")[2],
            changes=read_table(change, CHANGES)[0],
            visibility=read_table(seen, VISIBILITY)[0],
            area_m2=area,
            control=read_json(how),
            registration=read_json(moved),
            volumes=pd.read_csv(volume),
            patches=pd.read_csv(patch),
            difference=pd.read_csv(difference),
        )
        for change, seen, how, moved, volume, patch, difference in zip(
            changes, visibility, control, registrations, volumes, patches, differences, strict=True
        )
    ]


# ---------------------------------------------------------------- in words


def cubic_metres(row: Mapping[str, float]) -> str:
    """``−12.0 ± 0.6 m³``: a volume with its standard deviation, to two digits of that."""
    volume, sigma = row["volume_m3"], row["sigma_m3"]
    digits = int(min(1 - np.floor(np.log10(max(sigma, 1e-9))), 3)) if sigma else 1
    decimals = max(digits, 0)
    return f"{signed(round(volume, digits), decimals)} ± {number(round(sigma, digits), decimals=decimals)} m³"


def told(row: Mapping[str, float], *, known: bool) -> str:
    """What a volume and its interval say; nothing where no sigma is stated or estimated."""
    if not known:
        return "no verdict: no standard deviation is stated or estimated"
    return "significant at 95 %" if row["low_m3"] > 0 or row["high_m3"] < 0 else "not significant at 95 %"


def contradiction(pair: PairFacts) -> str:
    """A warning if the volume along normals and that of heights are no volume of one change; else nothing.

    Both have the same shared errors, so that they may differ by less than either errs.
    """
    normal, vertical = pair.volume("net"), pair.heights
    one, two = normal["volume_m3"], vertical["volume_m3"]
    sigma = np.nanmax([normal["sigma_m3"], vertical["sigma_m3"], 0.0])
    apart = abs(one - two) > 1.96 * sigma
    opposite = one * two < 0 and max(abs(one), abs(two)) > sigma
    if not (apart or opposite):
        return ""
    how = "have opposite signs" if one * two < 0 else "contradict each other"
    return (
        f"Warning: the net volume along normals is {cubic_metres(normal)}, that of heights "
        f"{cubic_metres(vertical)}; they {how}. Trust neither before the areas that only one of them covers "
        "are known (vegetation_roughness_m, reach_m, water and masks)."
    )


def both_volumes(pair: PairFacts) -> str:
    """The net volume along normals and by heights, and why they differ."""
    normal, vertical = pair.volume("net"), pair.heights
    things = pair.changes["state"].isin(("vegetation", "object"))
    area = pair.area_m2[things]
    theirs = float((pair.changes.loc[things, "distance_m"] * area).sum())
    return (
        f"Net along normals {cubic_metres(normal)} on {count(normal['area_m2'])} m² of surface, by heights "
        f"{cubic_metres(vertical)} on {count(vertical['area_m2'])} m² of the map. They cover "
        "different areas: along normals the core points measured in both epochs, without "
        f"{count(area.sum())} m² of plants, objects and rough relief ({signed(theirs, 1)} m³); by heights "
        "every cell with a height in both epochs."
    )


def taken_off(registration: Mapping[str, Any]) -> tuple[str, str]:
    """The height offset that was removed from the second epoch, and on what ground."""
    if "would_be" in registration:
        would = 100 * registration["would_be"]["up_m"]
        return (
            "none",
            f"no stable ground is drawn; the majority of the surface suggests {signed(would, 1)} cm",
        )
    if "parameters" not in registration:
        return "none", "deformation.registration is none"
    value, sigma = (100 * registration[each]["up_m"] for each in ("parameters", "sigmas"))
    drawn = registration["areas"] == "drawn"
    areas = f"drawn ground, {registration['n_areas']} areas" if drawn else "the majority of the bank"
    return f"{signed(value, 1)} ± {sigma:.1f} cm", f"from {areas}"


def head(pairs: Sequence[PairFacts]) -> tuple[str, list[Finding]]:
    """The first sentences and the numbers of the last pair, which spans all epochs, each with its verdict."""
    if not pairs:
        return "No pair of epochs.", []
    pair = pairs[-1]
    parts = {what: pair.volume(what) for what in ("erosion", "deposition", "net")}
    verdicts = {what: told(row, known=pair.sigma_known) for what, row in parts.items()}
    total = float(pair.area_m2.sum())
    findings = [
        Finding("volume of erosion", cubic_metres(parts["erosion"]), verdicts["erosion"]),
        Finding("volume of deposition", cubic_metres(parts["deposition"]), verdicts["deposition"]),
        Finding(
            "net volume along normals, insignificant changes included",
            cubic_metres(parts["net"]),
            verdicts["net"],
        ),
        Finding(
            "net volume by heights", cubic_metres(pair.heights), told(pair.heights, known=pair.sigma_known)
        ),
        Finding("height offset removed from the second epoch", *taken_off(pair.registration)),
        Finding("median level of detection (95 %)", centimetres(float(pair.changes["lod95_m"].median()))),
        Finding(
            "no data in one epoch (excluded from volumes)",
            f"{number(pair.unseen_m2, decimals=1)} of {count(total)} m²",
        ),
    ]
    lead = (
        f"the net volume is {verdicts['net']}." if pair.sigma_known else f"{verdicts['net']} for both epochs."
    )
    if "would_be" in pair.registration:
        value = signed(100 * pair.registration["would_be"]["up_m"], 1)
        lead += (
            " No stable ground is drawn, so the epochs were not registered: a common offset may remain. The "
            f"majority of the surface suggests {value} cm."
        )
    warnings = [words for each in pairs if (words := contradiction(each))]
    return " ".join([f"{pair.words}: {lead}", both_volumes(pair), *warnings]), findings


def verdict(pair: PairFacts) -> str:
    """What changed between two epochs, in sentences.

    Raises
    ------
    InputError : the volumes are incomplete.
    """
    erosion, deposition, net = (pair.volume(what) for what in ("erosion", "deposition", "net"))
    n = int(pair.changes["distance_m"].notna().sum())
    total = float(pair.area_m2.sum())
    beyond = told(net, known=True).startswith("significant")
    zero = (
        f"which is {'' if beyond else 'not '}significantly different from zero at 95 % (± is one standard "
        "deviation)."
        if pair.sigma_known
        else "on which there is no verdict, as no standard deviation is stated or estimated."
    )
    median = float(pair.changes["lod95_m"].median())
    words = [
        f"{pair.words}: {cubic_metres(erosion)} by erosion on {erosion['area_m2']:.1f} m² and "
        f"{cubic_metres(deposition)} by deposition on {deposition['area_m2']:.1f} m² of bare ground that "
        f"{'changed significantly' if pair.sigma_known else 'exceeds the roughness'}; net, with "
        f"insignificant changes, {cubic_metres(net)}, {zero}",
        f"The median level of detection (95 %) of the {count(n)} measured core points is "
        f"{centimetres(median)}.",
        largest_patches(pair.patches),
        _motion(pair.registration),
        f"{number(pair.unseen_m2, decimals=1)} m² ({100 * pair.unseen_m2 / total:.1f} % of {count(total)} "
        "m²) have no data in one epoch or both and are excluded from volumes.",
    ]
    return " ".join(filter(None, words))


def largest_patches(patches: pd.DataFrame) -> str:
    """The largest patch of erosion and of deposition, by volume."""
    words = []
    for what, sign in (("erosion", 1.0), ("deposition", -1.0)):
        rows = patches[(patches["what"] == what) & patches["mean_distance_m"].notna()]
        if len(rows):
            row = rows.iloc[int((sign * rows["volume_m3"]).to_numpy().argmin())]
            words.append(
                f"The largest patch of {what} has {row['area_m2']:.1f} m², "
                f"{signed(row['volume_m3'], 1)} m³ and "
                f"{centimetres(row['mean_distance_m'], sign=True)} on average."
            )
    return " ".join(words) or "No connected patch of change is large enough to be listed."


def _motion(registration: Mapping[str, Any]) -> str:
    """Whether the epochs moved against each other, and what stable ground cannot tell."""
    if "would_be" in registration:
        would = registration["would_be"]
        words = ", ".join(f"{a} {signed(100 * would[f'{a}_m'], 1)} cm" for a in _ENU)
        return (
            "The epochs were not registered, as no stable ground is drawn. The majority of the surface "
            f"suggests a motion of the second epoch of {words}, which may be change or an offset."
        )
    if "parameters" not in registration:
        return "The epochs were not registered on each other."
    values, sigmas = registration["parameters"], registration["sigmas"]
    shift = ", ".join(
        f"{axis} {signed(100 * values[f'{axis}_m'], 1)} ± {100 * sigmas[f'{axis}_m']:.1f} cm"
        for axis in _ENU
        if sigmas[f"{axis}_m"] > 0
    )
    words = (
        f"On stable ground the second epoch lies off the first by {shift}: "
        f"{'more than' if registration['needed'] else 'no more than'} the errors of both surveys explain "
        f"(p = {registration['p_value']:.2g}), so that a registration was "
        f"{'needed' if registration['needed'] else 'not needed'}; the motion is corrected "
        f"{'' if registration['needed'] else 'all the same '}and its uncertainty is in the sigmas."
    )
    hidden = [direction(each) for each in registration["not_shown"]]
    return words + (
        f" Stable ground does not determine {' and '.join(hidden)}, which stays uncorrected."
        if hidden
        else ""
    )


def direction(motion: Sequence[float]) -> str:
    """A direction in the space of a registration's parameters in words, by its largest part.

    Parameters
    ----------
    motion : shifts east, north, up, and with them the rotation about up, or those about all three axes.

    Examples
    --------
    >>> direction([0.98, -0.17, 0.1])
    'a shift along 100° (azimuth)'
    >>> direction([0.0, 0.1, 0.0, 0.99])
    'a rotation about up'
    """
    shift, turn = np.asarray(motion[:3], float), np.asarray(motion[3:], float)
    if turn.size and np.abs(turn).max() > np.abs(shift).max():
        return f"a rotation about {_ENU[-turn.size :][int(np.argmax(np.abs(turn)))]}"
    if abs(shift[2]) > np.hypot(shift[0], shift[1]):
        return "a shift upward"
    return f"a shift along {np.rad2deg(np.arctan2(shift[0], shift[1])) % 180.0:.0f}° (azimuth)"


def limits(pairs: Sequence[PairFacts]) -> str:
    """What the page does not hold."""
    drawn = any(pair.registration.get("areas") == "drawn" for pair in pairs)
    nothing = any("would_be" in pair.registration for pair in pairs)
    stable = (
        "No stable ground was drawn, so that a common offset of the epochs may remain. The intervals include "
        "it as far as it is stated or can be estimated."
        if nothing
        else "Stable ground was drawn by hand; whether it was stable, only an area that moved against the "
        "others would show."
        if drawn
        else "No stable areas were drawn: the motion of the majority of the ground counts as an error "
        "of registration. Ground that moved as a whole looks stable. Draw deformation.stable where stable "
        "ground is known."
    )
    files = any((pair.visibility[f"reason_{i}"] == "no trajectory").any() for pair in pairs for i in (1, 2))
    elsewhere = (
        "External clouds and surface models have no trajectory: an area without points was either empty or "
        "not observed. Their errors are as stated, with one correlation length.\n\n"
    )
    return (
        f"{stable}\n\n"
        f"{elsewhere if files else ''}"
        "A distance is measured along the normal of the first surface (of the last, where the first has "
        "none). Motion within the surface remains undetected.\n\n"
        "Volumes of erosion and deposition sum significant changes only. Changes below the level of "
        "detection are missing in them, and errors above it are included; the column 'bias' estimates the "
        "effect of both, without correction. The net volume has no threshold. Areas without data, plants and "
        "objects are excluded. An erosion proved only by beams that passed through (free space) has an "
        "area and no volume.\n\n"
        "The errors of the poses are a model: processes with estimated sizes and correlation times. Errors "
        "that follow the surface (angle of incidence, wet ground, grass) are known only as far as points "
        "scatter within a cylinder. Significance speaks of each core point; neighbours share their errors, "
        "so that a patch of significant core points is not as many proofs."
    )


# ---------------------------------------------------------------- page


def change_page(
    epochs: Sequence[Mapping[str, Any]],
    pairs: Sequence[PairFacts],
    *,
    pictures: Sequence[Path] = (),
    captions: Mapping[str, str] | None = None,
    series: tuple[Mapping[str, Any], pd.DataFrame] | None = None,
    truth: Mapping[str, pd.DataFrame] | None = None,
    polygons: Mapping[str, pd.DataFrame] | None = None,
    by_boat: bool = True,
    title: str = "Change between epochs",
    twin: bool = False,
) -> Page:
    """The page that says what changed, how sure that is, and what nobody saw.

    Parameters
    ----------
    epochs : ``errors.json`` of each epoch, in the order of time.
    pairs : what was found out about each pair.
    pictures : PNG files, shown in their order.
    captions : stem of a picture -> its caption.
    series : of more than two epochs, ``jumps.json`` and ``retreat_rates.csv``.
    truth : for a twin, ``measure, value, n`` of the comparison with the true change by pair.
    polygons : for a twin, measured and true volumes of each change by pair.
    by_boat : an epoch has the trajectory of a boat.
    title : heading.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : the volumes of a pair are incomplete, or a picture is missing.
    """
    page = Page(title, *head(pairs))
    if twin:
        page.text(
            "The digital twin made these data: the surveys and the change between them are simulated. The "
            "figures speak of the software and of the models of the instruments, not of real ground."
        )
    page.section("Interpretation")
    for pair in pairs:
        in_head = pair is pairs[-1]
        page.text(verdict(pair) if in_head else f"{verdict(pair)} {both_volumes(pair)}")
    _volumes(page, pairs)
    _states(page, pairs)
    page.pictures(pictures, captions, "significance_map")
    if series is not None:
        _series(page, *series, by_boat=by_boat)
    _differences(page, pairs)
    _registration(page, pairs)
    _unseen(page, pairs)
    _epochs(page, epochs)
    if truth:
        _truth(page, truth, polygons or {})
    if notes := [f"{pair.words}: {note}" for pair in pairs for note in pair.control.get("notes", ())]:
        page.section("Notes on the data").text("\n\n".join(notes))
    page.section("Limits").text(limits(pairs))
    return page


def write_change_page(
    *,
    errors: list[Path],
    changes: list[Path],
    visibility: list[Path],
    control: list[Path],
    registrations: list[Path],
    volumes: list[Path],
    patches: list[Path],
    differences: list[Path],
    core_points: Path,
    series: list[Path],
    truth: list[Path],
    polygons: list[Path],
    pictures: list[Path],
    captions: dict[str, str],
    by_boat: bool,
    title: str,
    twin: bool,
    page: Path,
) -> None:
    """The same from files, as the workflow has them: one of each for a pair; `title`: of the campaign."""
    change_page(
        [read_json(path) for path in errors],
        read_pair_facts(
            changes, visibility, control, registrations, volumes, patches, differences, core_points
        ),
        pictures=pictures,
        captions=captions,
        series=(read_json(series[0]), pd.read_csv(series[1])) if series else None,
        truth={path.stem.rpartition("_")[2]: pd.read_csv(path) for path in truth},
        polygons={path.stem.rpartition("_")[2]: pd.read_csv(path) for path in polygons},
        title=f"Change of {scene(by_boat).thing}: {title}",
        by_boat=by_boat,
        twin=twin,
    ).write(page)


def _of_pairs(
    frames: Sequence[tuple[PairFacts, pd.DataFrame]], columns: Sequence[tuple[str, str, str]], first: str
) -> tuple[pd.DataFrame, dict[str, str]]:
    """Tables of pairs below each other: pair, ``first``, columns under their headings; and units."""
    rows = [
        table[[first, *(name for name, _, _ in columns)]].assign(epochs=pair.name.replace("-", " to "))
        for pair, table in frames
    ]
    out = pd.concat(rows, ignore_index=True) if rows else pd.DataFrame(columns=["epochs", first])
    out = out[["epochs", *(name for name in out.columns if name != "epochs")]]
    units = {heading: unit for _, heading, unit in columns}
    return out.rename(columns={"what": "class"} | {name: heading for name, heading, _ in columns}), units


def _volumes(page: Page, pairs: Sequence[PairFacts]) -> None:
    page.section("Volumes and patches").text(
        "Negative: erosion. Positive: deposition. Their standard deviations "
        "come from the errors that neighbouring core points share: errors of poses, mounts and registration "
        "do not average out over a surface as noise does."
    )
    table, units = _of_pairs([(pair, pair.volumes) for pair in pairs], VOLUMES, "what")
    caption = "Volumes; bias: effect of the threshold of significance; no data: excluded area"
    page.table(table, caption, units, digits=3)
    table, units = _of_pairs([(pair, pair.patches.head(MOST_PATCHES)) for pair in pairs], PATCHES, "what")
    n = sum(len(pair.patches) for pair in pairs)
    if n:
        caption = f"Connected patches, the largest first: {len(table)} of {n}; coordinates in the local frame"
        page.table(table, caption, units, digits=3)


def _differences(page: Page, pairs: Sequence[PairFacts]) -> None:
    page.section("Difference of heights").text(
        "Heights of both epochs in cells of the map and their difference (dod_<pair>.tif: difference and "
        "standard deviation). Of clouds it is the mean height about the middle of each cell, registered as "
        "the distances are; of two surface models the difference of the rasters, without the height "
        "offset that was removed. On steep ground distances along normals are more accurate."
    )
    table, units = _of_pairs([(pair, pair.difference) for pair in pairs], DIFFERENCES, "part")
    page.table(table, "Volumes of the difference of heights", units, digits=3)


def _states(page: Page, pairs: Sequence[PairFacts]) -> None:
    how = sorted(
        {CONTROL_IN_WORDS[p.control["control"]].format(percent=100 * p.control["level"]) for p in pairs}
    )
    page.section("Core points by class").text(
        f"Significant means: {'; '.join(how)}. Positive distances lead out of the ground."
    )
    rows = []
    for pair in pairs:
        for state in STATES:
            use = pair.changes["state"] == state
            if use.any():
                rows.append(
                    {
                        "epochs": pair.name.replace("-", " to "),
                        "state": state,
                        "n": int(use.sum()),
                        "area": float(pair.area_m2[use].sum()),
                        "share": float(100 * pair.area_m2[use].sum() / pair.area_m2.sum()),
                        "median distance": float(100 * pair.changes.loc[use, "distance_m"].median()),
                        "median sigma": float(100 * pair.changes.loc[use, "sigma_m"].median()),
                    }
                )
    units = {"area": "m²", "share": "%", "median distance": "cm", "median sigma": "cm"}
    page.table(rows, "Core points by state", units, digits=3)


def _series(page: Page, facts: Mapping[str, Any], rates: pd.DataFrame, *, by_boat: bool) -> None:
    """Epochs that jump and return, closure, and rates of retreat."""
    epochs, closed = facts["epochs"], facts["closure"]
    flagged = [f"epoch {each['epoch'] + 1} ({each['name']})" for each in epochs if each["flagged"]]
    page.section("More than two epochs").text(
        (
            f"Check {' and '.join(flagged)}: most of the ground moves and returns, which suggests a "
            "survey error. Nothing was corrected."
            if flagged
            else "No epoch jumps and returns over most of the ground."
        )
        + (
            " No epoch was registered, as no stable ground is drawn. Were each pair"
            if "would_be" in facts["network"]
            else " All epochs are registered to each other in one adjustment, in which changes close. Were "
            "each pair"
        )
        + " registered by itself, the changes from epoch to epoch would miss that from first to last by "
        f"{100 * closed['rms_m']:.1f} cm (root mean square of n = {count(closed['n'])} core points)."
    )
    network = facts["network"]
    if "parameters" in network:
        motions = pd.DataFrame(
            {
                "epoch": np.arange(len(network["parameters"])) + 1,
                **{
                    name.removesuffix("_m").replace("_", " "): [
                        f"{1e3 * value[name]:+.1f} ± {1e3 * sigma[name]:.1f}"
                        for value, sigma in zip(network["parameters"], network["sigmas"], strict=True)
                    ]
                    for name in network["parameters"][0]
                    if any(sigma[name] > 0 for sigma in network["sigmas"])
                },
            }
        )
        page.table(
            motions,
            "Motions of the epochs against their mean, with standard deviations (stable core points: "
            f"{count(network['stable_cores'])})",
            {name: "mrad" if name.startswith("turn") else "mm" for name in motions.columns[1:]},
        )
    rows = pd.DataFrame(epochs)
    shown = pd.DataFrame(
        {
            "epoch": rows["epoch"] + 1,
            "campaign": rows["name"],
            "n": rows["n"],
            "median change from the previous": 100 * rows["before_m"],
            "median change to the next": 100 * rows["after_m"],
            "reversed": 100 * rows["share"],
            "flagged": np.where(rows["flagged"], "yes", "no"),
        }
    )
    units = {"median change from the previous": "cm", "median change to the next": "cm", "reversed": "%"}
    page.table(shown, "Test of each epoch for a jump, before any registration", units, digits=2)
    if len(rates):
        columns = ["line", "s_from_m", "s_to_m", "cores", "n_epochs", "lrr_m_a", "sigma_lrr_m_a"]
        names = {"s_from_m": "from", "s_to_m": "to", "cores": "core points", "n_epochs": "epochs",
                 "lrr_m_a": "rate", "sigma_lrr_m_a": "sigma"}  # fmt: skip
        units = {"from": "m", "to": "m", "rate": "m/a", "sigma": "m/a"}
        words = scene(by_boat).lines
        shown = rates[columns].rename(columns=names).assign(line=rates["line"].map(words))
        caption = f"Rates of {' and '.join(words.values())} by regression over all epochs; negative: retreat"
        page.table(shown, caption, units, digits=3)


def _registration(page: Page, pairs: Sequence[PairFacts]) -> None:
    page.section("Registration").text(
        "A motion between the epochs is estimated from stable ground and corrected. Its covariance follows "
        "from the errors of both surveys; all of its components are tested together. Components that stable "
        "ground does not determine stay zero."
    )
    rows, tests = [], []
    for pair in pairs:
        found = pair.registration
        name = pair.name.replace("-", " to ")
        if "parameters" not in found:
            page.text(f"{pair.words}: not registered ({taken_off(found)[1]}).")
            continue
        if "by_area" in found:
            _by_area(page, pair)
        for key, words in MOTIONS.items():
            turn = key.startswith("turn")
            value, sigma = found["parameters"][key], found["sigmas"][key]
            if sigma == 0:
                continue
            scale = np.rad2deg(1.0) if turn else 100.0
            rows.append(
                {
                    "epochs": name,
                    "motion": words,
                    "value": float(scale * value),
                    "sigma": float(scale * sigma),
                    "unit": "°" if turn else "cm",
                }
            )
        tests.append(
            {
                "epochs": name,
                "model": found["model"],
                "stable ground": found["areas"],
                "stable core points": int(found["stable_cores"]),
                "bare core points": int(found["candidates"]),
                "chi-squared": float(found["test_statistic"]),
                "degrees of freedom": int(found["degrees_of_freedom"]),
                "p": float(found["p_value"]),
                "needed": "yes" if found["needed"] else "no",
                "not determined": "; ".join(direction(each) for each in found["not_shown"]) or "–",
            }
        )
    if rows:
        page.table(rows, "Motion of the second epoch against the first", digits=3)
        page.table(tests, "Significance of the registration", digits=3)


def _by_area(page: Page, pair: PairFacts) -> None:
    """How far each drawn area lies off the motion of all."""
    found = pair.registration
    rows = pd.DataFrame(found["by_area"]).assign(off_m=lambda each: 100 * each["off_m"].astype(float))
    names = {"east_m": "east", "north_m": "north", "off_m": "off the motion of all"}
    caption = (
        f"{pair.words}: stable areas that lie apart, and the median of their places after the motion; its "
        f"standard deviation is by {found['sigma_from']}"
    )
    units = {"east": "m", "north": "m", "off the motion of all": "cm"}
    page.table(rows.rename(columns=names), caption, units, digits=3)


def _unseen(page: Page, pairs: Sequence[PairFacts]) -> None:
    page.section("No data").text(
        "A core point without data in an epoch is not necessarily eroded: it may have been under water, "
        "occluded or out of reach. Only beams that passed through and hit something behind (free space) "
        "prove that the surface is gone."
    )
    rows = []
    for pair in pairs:
        for i, epoch in enumerate(pair.name.split("-"), start=1):
            unseen = ~pair.visibility[f"seen_{i}"].astype(bool)
            reasons = pair.visibility.loc[unseen, f"reason_{i}"]
            for reason, n in reasons.value_counts().items():
                area = float(pair.area_m2[reasons.index[reasons == reason]].sum())
                names = {"epochs": pair.name.replace("-", " to "), "no data in epoch": epoch}
                rows.append({**names, "reason": str(reason), "n": int(n), "area": area})
    if rows:
        page.table(rows, "Core points that an epoch did not see", {"area": "m²"}, digits=3)


def _epochs(page: Page, epochs: Sequence[Mapping[str, Any]]) -> None:
    page.section("Epochs and their errors").text(
        "Errors that points share, by group: root mean squares over the survey, and how long, or how far, "
        "they are correlated. Pose errors are shared by points of the same time; those of external clouds "
        "and surface models are as stated in the campaign file."
    )
    about = [
        {
            "epoch": i,
            "campaign": each["name"],
            "start": utc_text_from_gps(each["start_gps_s"], 0),
            "points": int(each["points"]),
        }
        for i, each in enumerate(epochs, start=1)
    ]
    page.table(about, "Epochs")
    rows = []
    for i, each in enumerate(epochs, start=1):
        for group in each["groups"]:
            sigma = np.asarray(group["sigma"], dtype=float).reshape(-1, 3)
            # of a pose: the shift, then the rotation
            for part, unit in zip(sigma, group["unit"].split(", "), strict=True):
                turn = unit == "rad"
                sizes = (np.rad2deg(1.0) if turn else 100.0) * part
                kind = (", rotation" if turn else ", shift") if len(sigma) > 1 else ""
                rows.append(
                    {
                        "epoch": i,
                        "error": GROUPS_IN_WORDS.get(group["name"], group["name"]) + kind,
                        "correlation": group["lasts"],
                        **dict(zip(_ENU, sizes.tolist(), strict=True)),
                        "unit": "°" if turn else "cm",
                    }
                )
    caption = "Standard deviations along east, north and up; of rotations about these axes"
    page.table(rows, caption, digits=2)


def _truth(page: Page, truth: Mapping[str, pd.DataFrame], polygons: Mapping[str, pd.DataFrame]) -> None:
    page.section("Against the truth of the digital twin").text(
        "The twin knows the true surface of each epoch; no processing step can read it. Only bare ground is "
        "compared, without plants and objects. If sigmas are right, the mean of squared errors over "
        "variances is one over many pairs. One pair may differ, as its errors are common to the surface."
    )
    for name, table in truth.items():
        words = table["measure"].map(lambda each: TRUTH_IN_WORDS.get(each, each.replace("_", " ")))
        rows = pd.DataFrame({"measure": words, "value": table["value"], "n": table["n"]})
        page.table(rows, f"Epochs {name.replace('-', ' to ')}: measured and true change", digits=3)
        if name in polygons:
            _polygons(page, name, polygons[name])


def _polygons(page: Page, name: str, table: pd.DataFrame) -> None:
    """Volumes of the changes that the twin has."""
    shown = table[table["cores"] > 0]
    units = {"true": "m³", "of what was seen": "m³", "measured": "m³", "sigma": "m³"}
    rows = pd.DataFrame(
        {
            "change": shown["name"].str.replace("_", " "),
            "kind": shown["kind"],
            "n": shown["cores"],
            "true": shown["true_m3"],
            "of what was seen": shown["expected_m3"],
            "measured": shown["measured_m3"],
            "sigma": shown["sigma_m3"],
            "error over sigma": (shown["measured_m3"] - shown["expected_m3"]) / shown["sigma_m3"],
        }
    )
    caption = (
        f"Epochs {name.replace('-', ' to ')}: net volumes of ground by change. True: of all ground above the "
        "water; of what was seen: true change at the n core points that the measured volume sums"
    )
    page.table(rows, caption, units, digits=3)
