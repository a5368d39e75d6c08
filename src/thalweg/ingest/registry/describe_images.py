"""What photographs and the tables beside them hold, in lines for a terminal."""

import re
from pathlib import Path
from typing import Final

from thalweg.core.errors import ClockError, InputError
from thalweg.ingest.integrity import IntegrityReport
from thalweg.ingest.photos.exif import read_head
from thalweg.ingest.photos.stamps import read_image_stamps
from thalweg.ingest.registry.describe_calibration import CalibrationReport
from thalweg.ingest.registry.recognise import KINDS

_KEYS: Final = {
    "control_points": "logs.time_lapse.control_points",
    "marks": "logs.time_lapse.marks",
    "gcp_list": "logs.time_lapse.control_points and logs.time_lapse.marks",
    "metashape_markers": "logs.time_lapse.control_points and logs.time_lapse.marks",
    "metashape_cameras": "logs.time_lapse.orientations",
    "orientations": "logs.time_lapse.orientations",
    "image_times": "logs.time_lapse.times",
}


def describe_images(kind: str, path: Path) -> IntegrityReport:
    """Report on a photograph, or on a table that belongs to photographs.

    Parameters
    ----------
    kind : one of those of `recognise` that photographs have to do with.
    path : the file.

    Raises
    ------
    InputError : the photograph is damaged, or the table is no UTF-8 text.
    """
    if kind == "photograph":
        head = read_head(path)
        report = CalibrationReport(stream="camera", format=KINDS[kind], files=[str(path)])
        report.model = f"{head.make} {head.model}".strip()
        report.details["size"] = f"{head.width} x {head.height} pixels"
        try:
            stamps = read_image_stamps(path)
        except ClockError as error:
            report.note(error.found)
        else:
            known = stamps.table["source"][0]
            report.details["time"] = f"{stamps.table['t_device_s'][0]:.3f} s (GPS time less 1e9) from {known}"
        return report
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(
            "no UTF-8 text", expected=KINDS[kind], where=path, cure="Save it as UTF-8"
        ) from error
    lines = [line for line in text.splitlines() if line.strip()]
    report = CalibrationReport(stream="images", format=KINDS[kind], files=[str(path)])
    if kind.startswith("metashape"):
        counted = {name: len(re.findall(rf"<{name}\s", text)) for name in ("camera", "marker", "location")}
        report.details["holds"] = ", ".join(f"{n} elements {name}" for name, n in counted.items() if n)
    else:
        report.details["begins"] = lines[0].strip()[:100]
        report.details["rows"] = str(len(lines) - 1)
    report.details["belongs"] = f"in {_KEYS[kind]} of a campaign file"
    return report
