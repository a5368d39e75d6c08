"""A good campaign of a real survey, whose logs are small dummy files, and a way to spoil it."""

import copy
from typing import Any

import pytest
import yaml

LOGS = {
    "raw/lidar_1.pcap": b"one",
    "raw/lidar_2.pcap": b"two",
    "raw/boat.anpp": b"three",
    "raw/ppk.pos": b"four",
    "raw/rover.sbp": b"five",
    "raw/base.sbp": b"six",
    "raw/echo.nmea": b"seven",
    "raw/empty.pcap": b"",
}

GOOD: dict[str, Any] = {
    "campaign": {
        "id": "good",
        "title": "A good campaign",
        "crs": "EPSG:25833",
        "origin": {"lat_deg": 51.05, "lon_deg": 13.25, "h_ell_m": 300.0},
        "seed": 5,
    },
    "logs": {
        "lidar": ["raw/lidar_1.pcap", "raw/lidar_2.pcap"],
        "ins": ["raw/boat.anpp"],
        "positions": ["raw/ppk.pos"],
        "gnss": {"rover": ["raw/rover.sbp"]},
        "depth": ["raw/echo.nmea"],
    },
    "lidar": {"model": "VLP-16"},
    "georeferencing": {"min_range_m": 0.5, "max_range_m": 120.0},
    "mounts": {
        "lidar": {"phi_deg": -90.0, "lever_ics_m": [-0.35, 0.0, -0.25]},
        "antenna": {"lever_ics_m": [0.1, 0.0, -0.45]},
        "echo_sounder": {"lever_ics_m": [0.2, 0.0, 0.3]},
    },
    "orientation": {"position_source": "pos", "accept_fixes": ["fixed", "float"]},
}

REMOVE = object()
"""Stands for a key that is taken out."""


def patched(changes: dict[str, Any]) -> dict[str, Any]:
    """The good campaign with other values at dotted paths."""
    data = copy.deepcopy(GOOD)
    for dotted, value in changes.items():
        *parents, last = dotted.split(".")
        place = data
        for key in parents:
            place = place.setdefault(key, {})
        if value is REMOVE:
            del place[last]
        else:
            place[last] = value
    return data


@pytest.fixture
def survey(tmp_path):
    """Folder with the dummy logs."""
    for name, content in LOGS.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(content)
    return tmp_path


@pytest.fixture
def write(survey):
    """Writes the good campaign with changes at dotted paths, or the text given."""

    def write(changes=None, name="good.yaml"):
        path = survey / name
        text = (
            changes if isinstance(changes, str) else yaml.safe_dump(patched(changes or {}), sort_keys=False)
        )
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def removed():
    """The mark that takes a key out."""
    return REMOVE
