"""The section ``twin``: sizes, changes on top of them, and what is refused."""

import json

import pytest
from pydantic import TypeAdapter, ValidationError

from thalweg_lab.instruments.lidar import HOUR_US
from thalweg_lab.settings import TwinConfig
from thalweg_lab.settings.survey import SIZES
from thalweg_lab.voyage import start_unix


@pytest.mark.parametrize("size", list(SIZES))
def test_a_size_survives_being_written_out(size):
    config = TypeAdapter(TwinConfig).validate_json(json.dumps({"size": size}), strict=True)
    assert TwinConfig(**config.model_dump(mode="json")) == config
    assert TypeAdapter(TwinConfig).validate_json(config.model_dump_json(), strict=True) == config


def test_sizes_last_as_long_as_they_say_and_tiny_crosses_an_hour():
    lengths = {size: TwinConfig.of_size(size).duration_s for size in SIZES}
    river = {"tiny": 25.0, "demo": 180.0, "mulde": 1025.0, "reach": 4150.0}
    # a basin has no voyage; its start alone counts
    basin = {"basin": 180.0, "basin_tiny": 180.0}
    assert lengths == river | {"field": 150.0, "field_tiny": 40.0} | basin
    for size, crosses in (("tiny", 1), ("demo", 0), ("mulde", 0)):
        config = TwinConfig.of_size(size)
        whole, micros = start_unix(config)
        start_us = whole * 1_000_000 + micros
        assert start_us % HOUR_US != 0
        assert (start_us + int(config.duration_s * 1e6)) // HOUR_US - start_us // HOUR_US == crosses


def test_defaults_are_the_published_inputs():
    config = TwinConfig.of_size("mulde")
    # P2 eq. 7: 3 cm over three components.
    assert config.lidar.sigma_range_m == pytest.approx(0.03 / 3**0.5, abs=5e-5)
    assert config.lidar.sigma_lateral_m == pytest.approx(0.03 / 3**0.5, abs=5e-5)
    ins = config.ins
    assert (ins.sigma_roll_deg, ins.sigma_pitch_deg, ins.sigma_heading_deg) == (0.1, 0.1, 0.2)
    assert config.gnss.sigma_m == (0.02, 0.02, 0.03)
    assert (config.boat.speed_mps, config.boat.turn_rate_degps) == (0.4, 7.0)
    assert (config.tls.spacing_m, config.tls.sigma_50m_m) == (0.025, 0.003)
    # Data sheet of the Spatial.
    assert ins.sigma_velocity_mps == 0.05


@pytest.mark.parametrize(
    ("data", "place", "fragment"),
    [
        ({"size": "huge"}, ("size",), "'field_tiny', 'basin' or 'basin_tiny'"),
        ({"start_utc": "2021-05-12T08:00:00"}, ("start_utc",), "not a UTC time"),
        ({"start_utc": "2021-05-12T08:00:00+02:00"}, ("start_utc",), "not a UTC time"),
        ({"start_utc": "yesterday"}, ("start_utc",), "not a UTC time"),
        ({"boat": {"speed": 1.0}}, ("boat", "speed"), "Extra inputs"),
        ({"effects": {"lost_packets": 2.0}}, ("effects", "lost_packets"), "less than or equal to 1"),
        ({"effects": {"damaged_streams": ["camera"]}}, ("effects", "damaged_streams", 0), "'lidar'"),
        ({"boat": 3}, ("boat",), "should be an object"),
        ({"tls": {"sigma_50m_m": 0.0}}, ("tls",), "sigma_floor_m 0.001 is larger than sigma_50m_m 0.0"),
        ({"tls": {"sigma_floor_m": 0.004}}, ("tls",), "lower it, to 0 for scans without noise"),
    ],
)
def test_mistakes_are_named(data, place, fragment):
    with pytest.raises(ValidationError) as error:
        TypeAdapter(TwinConfig).validate_json(json.dumps(data), strict=True)
    assert [(e["loc"], fragment in e["msg"]) for e in error.value.errors()] == [(place, True)]
