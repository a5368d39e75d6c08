"""A calibration field that several tests look at."""

from typing import Any

import pytest

from thalweg_lab.instruments import LidarSensor
from thalweg_lab.settings import TwinConfig
from thalweg_lab.voyage import FieldRun
from thalweg_lab.yard import build_field, field_scene
from thalweg_lab.yard_records import Scan, scan

SEED = 4


def small(**field: Any) -> TwinConfig:
    """The small field with changes in its section."""
    return TwinConfig.of_size("field_tiny", field=field)


@pytest.fixture(scope="session")
def field():
    return build_field(TwinConfig.of_size("field_tiny"), SEED)


@pytest.fixture(scope="session")
def yard(field):
    return field_scene(field)


@pytest.fixture(scope="session")
def run_scan():
    """Lidar recording of the run about the field: the capture of `simulate_lidar` before its packets."""

    def record(config: TwinConfig, seed: int, *, near_cones_m: float | None = 0.3, **mount: Any) -> Scan:
        field = build_field(config, seed)
        scene = field_scene(field).scene
        sensor = LidarSensor.on_board(config, seed, FieldRun(config, seed), scene, **mount)
        return scan(sensor, field, duration_s=config.duration_s, near_cones_m=near_cones_m)

    return record
