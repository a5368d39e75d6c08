"""The pictures that suit a recording, whatever it holds."""

from matplotlib.figure import Figure

from thalweg.core.errors import InputError
from thalweg.figures.cloud.overview import cloud_overview
from thalweg.figures.firstlook.first_looks import (
    attitude_first_look,
    depth_first_look,
    lidar_first_look,
    track_first_look,
)
from thalweg.ingest.registry.describe import Recording


def first_looks_of(recording: Recording, *, title: str, twin: bool = False) -> dict[str, Figure]:
    """First pictures of a recording, one for each kind of data in it: name -> figure.

    Parameters
    ----------
    recording : from `load_recording`.
    title : first words of the titles.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : the recording holds nothing that could be drawn.
    """
    figures: dict[str, Figure] = {}
    if recording.points_scs_m is not None and recording.intensity is not None and recording.ring is not None:
        figures["points"] = lidar_first_look(
            recording.points_scs_m, recording.intensity, recording.ring, title=title, twin=twin
        )
    if recording.cloud_m is not None and len(recording.cloud_m):
        figures["cloud"] = cloud_overview(recording.cloud_m, title=title, twin=twin)
    for name, draw in (
        ("depths", depth_first_look),
        ("states", attitude_first_look),
        ("positions", track_first_look),
    ):
        table = recording.tables.get(name)
        if table is not None and not table.empty:
            figures[name] = draw(table, title=title, twin=twin)
    if not figures:
        raise InputError(
            "the recording holds no points, depths, attitudes or positions",
            where=", ".join(recording.report.files),
            cure="Look at its integrity report with `thalweg describe`",
        )
    return figures
