"""What the page of the riverbed says: the light sheet, runs that disagree, depth against width."""

from thalweg.figures.bathymetry.page import _crossings, _depth_and_width, _light_sheet

SHEET = {
    "light sheet": 49,
    "light sheet above the soundings_m": 1.2162,
    "light sheet above the soundings, sigmas": 50.3,
}


def test_a_light_sheet_that_is_left_out_says_why():
    assert _light_sheet({"soundings": 5}) == ""
    out = _light_sheet(SHEET | {"light sheet left out": 49})
    assert "49 places" in out
    assert "+121.6 cm" in out
    assert "+50.3 standard deviations" in out
    assert "no part" in out
    assert _light_sheet(SHEET | {"light sheet left out": 0}).endswith("are part of it.")


def test_depth_against_width_in_words():
    found = {"sections": 18, "exponent": -0.83, "sigma_exponent": 0.2, "deeper_where_narrower": True}
    assert "power of -0.83 ± 0.20: it is deeper where it is narrower." in _depth_and_width(found)
    assert "is not significant" in _depth_and_width(found | {"deeper_where_narrower": False})
    at_weir = _depth_and_width(found | {"ratio_at_weir": 1.32, "sigma_ratio_at_weir": 0.03})
    assert "1.32 ± 0.03 times as deep" in at_weir
    assert _depth_and_width({"not_told": "6 sections."}) == " Depth against width: 6 sections."
    assert _depth_and_width({}) == ""


def test_runs_that_disagree_are_named():
    few = {"n": 24, "rms_m": 0.31, "predicted_m": 0.05, "normalised_square": 38.0, "estimated": False}
    assert _crossings(few).endswith(
        "They are too few to estimate the time-correlated errors: the stated ones are used."
    )
    out = _crossings(few | {"agreement": {"steps": []}, "notes": ["the run of 12:23 lies 0.300 m above b"]})
    assert "Those within one run are too few" in out
    assert out.endswith(" The run of 12:23 lies 0.300 m above b.")
