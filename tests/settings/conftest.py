"""A good campaign of a real survey, whose logs are small dummy files, and a way to spoil it."""

import re
from typing import Any

import pytest
import yaml

from thalweg.settings import load_campaign
from thalweg.settings.messages import CampaignError

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

GOOD = """
campaign:
  id: good
  title: A good campaign
  crs: EPSG:25833
  origin: {lat_deg: 51.05, lon_deg: 13.25, h_ell_m: 300.0}
  seed: 5
logs:
  lidar: [raw/lidar_1.pcap, raw/lidar_2.pcap]
  ins: [raw/boat.anpp]
  positions: [raw/ppk.pos]
  gnss: {rover: [raw/rover.sbp]}
  depth: [raw/echo.nmea]
lidar: {model: VLP-16}
georeferencing: {min_range_m: 0.5, max_range_m: 120.0}
mounts:
  lidar: {phi_deg: -90.0, lever_ics_m: [-0.35, 0.0, -0.25]}
  antenna: {lever_ics_m: [0.1, 0.0, -0.45]}
  echo_sounder: {lever_ics_m: [0.2, 0.0, 0.3]}
orientation: {position_source: pos, accept_fixes: [fixed, float]}
"""


def patched(changes: str | dict[str, Any]) -> dict[str, Any]:
    """The good campaign with other values at dotted paths; ``<removed>`` takes a key out."""
    data = yaml.safe_load(GOOD)
    for dotted, value in (yaml.safe_load(changes) if isinstance(changes, str) else changes).items():
        *parents, last = dotted.split(".")
        place = data
        for key in parents:
            place = place.setdefault(key, {})
        if value == "<removed>":
            del place[last]
        else:
            place[last] = value
    return data


def in_order(words: str) -> str:
    """Pattern of a message that holds these words in their order; `` ... `` stands for what is between."""
    return r"[\s\S]*".join(map(re.escape, words.split(" ... ")))


def mistakes_of(*campaign: Any) -> CampaignError:
    """What is wrong with a campaign, all of it."""
    with pytest.raises(CampaignError) as caught:
        load_campaign(*campaign)
    return caught.value


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
    """Writes the good campaign with changes at dotted paths, as YAML or as a dict."""

    def write(changes="{}", name="good.yaml"):
        path = survey / name
        path.write_text(yaml.safe_dump(patched(changes), sort_keys=False), encoding="utf-8")
        return path

    return write
