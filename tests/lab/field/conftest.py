"""A calibration field that several tests look at."""

import pytest

from thalweg.settings.twin import TwinConfig
from thalweg_lab.yard import Field, FieldScene, build_field, field_scene

SEED = 4


@pytest.fixture(scope="session")
def field() -> Field:
    return build_field(TwinConfig.of_size("field_tiny"), SEED)


@pytest.fixture(scope="session")
def yard(field: Field) -> FieldScene:
    return field_scene(field)
