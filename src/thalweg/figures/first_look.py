"""The picture that suits a recording, whatever it holds."""

from matplotlib.figure import Figure

from thalweg.core.errors import InputError
from thalweg.figures.first_looks import (
    attitude_first_look,
    depth_first_look,
    lidar_first_look,
    track_first_look,
)
from thalweg.ingest.describe import Recording


def first_look(recording: Recording, *, title: str, twin: bool = False) -> Figure:
    """First picture of a recording: cloud, else depth line, else attitude, else track.

    Parameters
    ----------
    recording : from `load_recording`.
    title : first words of the title.
    twin : true if the digital twin made the data.

    Raises
    ------
    InputError : the recording holds nothing that could be drawn.
    """
    if recording.points_scs_m is not None and recording.intensity is not None and recording.ring is not None:
        return lidar_first_look(
            recording.points_scs_m, recording.intensity, recording.ring, title=title, twin=twin
        )
    for name, draw in (
        ("depths", depth_first_look),
        ("states", attitude_first_look),
        ("positions", track_first_look),
    ):
        table = recording.tables.get(name)
        if table is not None and not table.empty:
            return draw(table, title=title, twin=twin)
    raise InputError(
        "the recording holds no points, depths, attitudes or positions",
        where=", ".join(recording.report.files),
        cure="Look at its integrity report with `thalweg describe`",
    )
