"""What the rules of the digital twin take: names of its logs, the ledger of published numbers, its true boat.

`twin_logs` is the plug-in that tells `thalweg.workflow.campaign_files` where the logs of a twin lie.
"""

import hashlib
import math
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

from thalweg.settings import Campaign
from thalweg.settings.sections import scan_stream
from thalweg.workflow import CampaignFiles
from thalweg_lab.reproduction import read_ledger, read_ledgers, result_files

_RAW_GNSS: Final = {"rover": ("raw/rover.sbp",), "base": ("raw/base.obs",), "nav": ("raw/base.nav",)}
_RIVER: Final = {
    "lidar": ("lidar.pcap",),
    "ins": ("ins.anpp",),
    "sbp": ("rover.sbp",),
    "pos": ("ppk.pos",),
    **_RAW_GNSS,
    "depth": ("echo.nmea",),
    "reference": ("tls_1.laz", "tls_2.laz", "tls_3.laz"),
}
_FIELD: Final = {
    "lidar": ("lidar.pcap",),
    "ins": ("ins.anpp",),
    "sbp": ("rover.sbp",),
    "pos": ("ppk.pos",),
    **_RAW_GNSS,
    "field": ("field.yaml",),
    "reference_images": ("reference_images",),
    "position_images": ("position_images",),
    "position_scans": ("position_scans",),
    "run_images": ("run_images",),
    "display": ("display",),
}
_BASIN: Final = {
    "sheet_sensor": ("light_sheet/sensor.yaml",),
    "camera_marks": ("light_sheet/camera_marks.csv",),
    "mark_points": ("light_sheet/mark_points.csv",),
    "grid_images": ("light_sheet/calibration/images",),
    "grid": ("light_sheet/calibration/grid_1.yaml",),
    "panel_images": ("light_sheet/panels/images",),
    "panels": ("light_sheet/panels/images.csv",),
}
_CAMERA_FIELD: Final = {
    "camera_field": ("light_sheet/camera_field.yaml",),
    "camera_field_marks": ("light_sheet/camera_field_marks.csv",),
}
_SCANS: Final = ("stepped", "wreck")
_SCAN: Final = {
    "images": "images",
    "pulses": "trigger_pulses.csv",
    "panel": "six_dof/panel.csv",
    "marks": "six_dof/marks.csv",
    "camera": "six_dof/camera.json",
    "reference": "reference.ply",
    "pairs": "pairs.csv",
}
_STRIP: Final = {
    "strip_images": ("light_sheet/strip/images",),
    "strip_pulses": ("light_sheet/strip/trigger_pulses.csv",),
}
_RIG: Final = {"rig_images": ("rig",)}
_RIG_FIELD: Final = {
    "rig_field_images": ("rig_field",),
    "rig_field": ("rig_field.yaml",),
    "rig_field_points": ("rig_field_points.csv",),
}
_IMAGES_OF_PART: Final = 30
"""Images that one job draws of not too many: to set up the scene takes as long as some of them."""
_REFERENCES_OF_PART: Final = 25
"""The same of the reflex camera, whose images are large."""
_MOST_PARTS: Final = 8
_TIME_LAPSE: Final = {"time_lapse": ("time_lapse",), "control_points": ("control_points.csv",)}


def twin_logs(campaign: Campaign) -> Mapping[str, Sequence[str]]:
    """Logs that the twin of a campaign writes.

    Parameters
    ----------
    campaign : with a section ``twin``.

    Returns
    -------
    Stream -> names below ``results/<campaign>/simulation/logs``; those without a suffix are folders. Empty
    without a twin.
    """
    twin = campaign.twin
    if twin is None:
        return {}
    known: dict[str, Sequence[str]] = {**(_FIELD if campaign.is_calibration else _RIVER)}
    if twin.light_sheet is not None:
        known = {**_BASIN, **(_CAMERA_FIELD if twin.light_sheet.lens_pictures else {})}
        if twin.light_sheet.scan_lines:
            known |= {
                scan_stream(scan, part): (f"light_sheet/{scan}/{log}",)
                for scan in _SCANS
                for part, log in _SCAN.items()
            }
    if twin.echo.bed_survey:
        known["bed"] = ("bed.csv",)
    if twin.time_lapse is not None:
        known |= _TIME_LAPSE
    if twin.dual_fisheye is not None:
        # where the boat was calibrated, its rig was, too
        known |= {} if campaign.is_calibration else _RIG
        known |= {} if campaign.mounts.calibration else _RIG_FIELD
    if twin.light_sheet_strip is not None:
        known |= _STRIP
    return known


def calibrated_boat(files: CampaignFiles) -> list[str]:
    """True mounts of the twin's calibration that a campaign names; its boat is the same."""
    chosen = files.calibration_campaign()
    twin = chosen is not None and files.of(chosen).is_twin()
    return [f"results/{chosen}/simulation/truth/mounts.json"] if twin else []


def n_images(campaign: Campaign) -> int:
    """About how many images of the bank the twin's boat takes."""
    twin = campaign.twin
    lapse = None if twin is None else twin.time_lapse
    return 0 if lapse is None else math.ceil(lapse.share * lapse.rate_hz * twin.duration_s)


def n_image_parts(files: CampaignFiles) -> int:
    """Jobs that draw the images of the bank."""
    return min(max(math.ceil(n_images(files.campaign) / _IMAGES_OF_PART), 1), _MOST_PARTS)


def image_parts(files: CampaignFiles) -> list[str]:
    """Folders of their images; few images are drawn by the job that brings them together."""
    n = n_image_parts(files)
    return [f"results/{files.name}/simulation/time_lapse_{k}" for k in range(n if n > 1 else 0)]


def n_reference_parts(files: CampaignFiles) -> int:
    """Jobs that draw the reflex camera's images of a calibration field."""
    n: int = files.section("twin", "camera", "reference", "n_images")
    return min(math.ceil(n / _REFERENCES_OF_PART), _MOST_PARTS)


def drawn_field_images(files: CampaignFiles, kind: str) -> list[str]:
    """Folders of parts of a kind of images of the field; few are drawn where they are brought together."""
    n = n_reference_parts(files) if kind == "reference" else 1
    return [f"results/{files.name}/simulation/reference_images_{k}" for k in range(n if n > 1 else 0)]


def rig_device(files: CampaignFiles) -> dict[str, Any]:
    """Seed and settings of the rig of a twin: those of the campaign in whose room it was calibrated."""
    room = files.of(files.calibration_campaign() or files.name).plain
    return {"seed": room["campaign"]["seed"], "settings": room["twin"]["dual_fisheye"]}


def sheet_basin(files: CampaignFiles) -> dict[str, Any]:
    """The twin of the basin in which the light-sheet sensor of a boat was calibrated.

    Raises
    ------
    KeyError : the boat carries no sensor.
    """
    basin = files.of(files.campaign.light_sheet.sensor or "").plain
    twin = {key: basin["twin"][key] for key in ("size", "light_sheet")}
    return {"seed": basin["campaign"]["seed"], "twin": twin}


# ---------------------------------------------------------------- ledger of published numbers

PUBLISHED: Final = "resources/published"
LEDGER: Final = f"{PUBLISHED}/light_sheet.yaml"
STORED: Final = (
    "resources/light_sheet/paper_3.yaml",
    "resources/light_sheet/paper_4.yaml",
    "resources/budgets/p2_table1.yaml",
    "resources/budgets/sajo_2019.yaml",
    "resources/budgets/sajo_2021.yaml",
)
"""Prototypes and budgets that computed numbers come from."""
_OF_PANELS: Final = ("triangulation/panels.csv", "triangulation/line_methods.csv")


@cache
def _ledger_files(root: Path, source: str) -> Sequence[str]:
    return result_files(read_ledger(root / LEDGER), source)


def has_ledger(files: CampaignFiles) -> bool:
    """True for a digital twin of the light-sheet sensor in a basin."""
    return files.campaign.is_basin and files.is_twin()


def ledger_results(files: CampaignFiles, root: Path) -> list[str]:
    """The files below the campaign's results that the ledger points to and the campaign makes.

    Parameters
    ----------
    files : of the campaign.
    root : folder of the repository.
    """
    compared = files.compared_scans()
    known = {"sheet": True, "panels": "panels" in files.sheet_series()}
    known |= {scan: scan in compared for scan in _SCANS}
    found = []
    for file in _ledger_files(root, "file"):
        parts = [part for part in Path(file).parts if part in known]
        series = "panels" if file in _OF_PANELS else parts[0] if parts else "sheet"
        if known[series]:
            found.append(f"results/{files.name}/{file}")
    return found


def ledger_studies(root: Path) -> dict[str, str]:
    """Studies that the ledger points to, as far as they were made, and what is in them.

    They are no inputs, so that no study of an hour is made or made again for the ledger's sake; a study that
    was made anew changes this value and with it the ledger.
    """
    names = [Path("results/reproduction") / file for file in _ledger_files(root, "study")]
    return {p.as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()[:12] for p in names if p.is_file()}


def records(root: Path) -> list[Path]:
    """Recorded tables that a ledger reads where a result was not made, and the files that say what they hold.

    Parameters
    ----------
    root : folder of the repository.
    """
    tables = {*(root / "docs/validation").glob("*.csv")}
    of_ledgers = {*(root / "docs/validation").glob("ledger_*.csv")}
    return sorted({*tables - of_ledgers, *(root / "config/studies").glob("*.yaml")})


@cache
def _whole_ledger(root: Path) -> Sequence[Any]:
    return read_ledgers(root / PUBLISHED)


def whole_ledger_results(root: Path) -> dict[str, str]:
    """What entries of all campaigns and studies point to, as far as it was made, and what is in it.

    They are no inputs, as those of `ledger_studies`.
    """
    entries = tuple(_whole_ledger(root))
    names = [Path("results") / name for name in result_files(entries)]
    names += [Path("results/reproduction") / name for name in result_files(entries, "study")]
    return {p.as_posix(): hashlib.sha256(p.read_bytes()).hexdigest()[:12] for p in names if p.is_file()}


def whole_ledger_campaigns(root: Path) -> list[str]:
    """Files of the campaigns whose settings entries point to."""
    settings = (e.ours.name for e in _whole_ledger(root) if e.ours.source == "setting")
    names = dict.fromkeys(name.split(".")[0] for name in settings)
    return [f"{root}/config/campaigns/{name}.yaml" for name in names]


def ledger_outputs(files: CampaignFiles) -> list[str]:
    """What `all` builds of the ledger, where there is one."""
    return [f"results/{files.name}/triangulation/ledger.md"] if has_ledger(files) else []


def ledger_table(files: CampaignFiles) -> list[str]:
    """The ledger for the page on the light-sheet sensor, where there is one."""
    return [f"results/{files.name}/triangulation/ledger.csv"] if has_ledger(files) else []
