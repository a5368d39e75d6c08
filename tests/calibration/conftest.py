"""What several files of this folder begin with."""

import pytest


@pytest.fixture
def field_text():
    """Text of a field's description: two cones with markers from the first id to the last, and two bars."""

    def text(first: list[int], second: list[int]) -> str:
        return f"""
thalweg_field: 1
markers: {{dictionary: DICT_4X4_250, module_m: 0.012}}
cones:
  - {{name: C1, markers: {first}, half_angle_deg: 25.0, length_m: 0.7}}
  - {{name: C2, markers: {second}, half_angle_deg: 25.0, length_m: 0.7}}
scale_bars:
  - {{name: S1, from: "80/0", to: "81/0", length_m: 1.5, sigma_m: 0.0001}}
  - {{name: S2, from: "82/0", to: "83/0", length_m: 1.5, sigma_m: 0.0001}}
"""

    return text
