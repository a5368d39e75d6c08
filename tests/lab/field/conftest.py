"""A calibration field that several tests look at."""

import pytest

from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.yard.layout import Field, build_field
from thalweg_lab.yard.scene import FieldScene, field_scene

SEED = 4


@pytest.fixture(scope="session")
def field() -> Field:
    return build_field(TwinConfig.of_size("field_tiny"), SEED)


@pytest.fixture(scope="session")
def yard(field: Field) -> FieldScene:
    return field_scene(field)
