"""Options of a PPK run: table of mistakes, sections of a campaign file, words for the engine."""

import re

import numpy as np
import pytest
import yaml

from thalweg.core import ConfigError
from thalweg.ingest.ppk import PpkOptions
from thalweg.ingest.ppk.options import engine_settings

BASE = (-2706105.2018, -4261210.8062, 3885598.6411)
GIVEN = {"base_ecef_m": BASE}
LLH = (37.773497750, -122.417811914, -6.2480)  # of BASE, header of the engine's own .pos file


PLACES = {
    "given by nothing: exactly one of base_ecef_m, base_llh": {},
    "given by base_ecef_m and base_llh": {**GIVEN, "base_llh": LLH},
    "given by base_ecef_m and base_source": {**GIVEN, "base_source": "from_sbp"},
    "not one of from_sbp, rinex_header": {"base_source": "average"},
    "all zero": {"base_ecef_m": (0.0, 0.0, 0.0)},
    "is all zero": {"base_llh": (0.0, 0.0, 0.0)},
    "from the centre of the earth": {"base_ecef_m": LLH},
    "not three finite numbers": {"base_ecef_m": (np.nan, 0.0, 0.0)},
    "three finite numbers": {"base_ecef_m": BASE[:2]},
    "not latitude (deg)": {"base_llh": (137.77, 22.4, 5.0)},
    "not three finite metres": {**GIVEN, "base_antenna_delta_enu_m": (0.0, np.inf, 0.0)},
}
OTHERS = {
    "'GALILEO'": "systems: [GPS, GALILEO]",
    "systems is ()": "systems: []",
    "ambiguity is 'fixed', not one of": "ambiguity: fixed",
    "direction is 'both'": "direction: both",
    "frequencies is 'l2'": "frequencies: l2",
    "needs two frequencies": "{frequencies: l1, iono: dual-freq}",
    "elevation_mask_deg is 95.0": "elevation_mask_deg: 95.0",
    "elevation_mask_deg is nan": "elevation_mask_deg: .nan",
    "ratio_threshold is 0.5": "ratio_threshold: 0.5",
    "max_age_s is 0.0": "max_age_s: 0.0",
}


@pytest.mark.parametrize("words", [*PLACES, *OTHERS])
def test_mistakes(words):
    options = PLACES[words] if words in PLACES else GIVEN | yaml.safe_load(OTHERS[words])
    options |= {"systems": tuple(options["systems"])} if "systems" in options else {}
    with pytest.raises(ConfigError, match=re.escape(words)):
        PpkOptions(**options)


def test_all_mistakes_at_once():
    with pytest.raises(ConfigError) as caught:
        PpkOptions(direction="both", max_age_s=-1.0)
    assert all(word in str(caught.value) for word in ("direction", "max_age_s", "base position"))


def test_geodetic_base_is_the_earth_centred_one():
    a = PpkOptions(base_llh=LLH).explicit_base_ecef_m
    assert a == pytest.approx(BASE, abs=2e-4)  # nine decimals of a degree are 0.1 mm


def test_sections_of_a_campaign():
    ppk = {"systems": ["GPS", "GAL"], "direction": "combined", "max_age_s": 10.0}
    place = {"base_ecef_m": None, "base_llh": None, "base_from": "sbp"}
    options = PpkOptions.from_sections(ppk, place)
    assert options == PpkOptions(
        systems=("GPS", "GAL"), direction="combined", max_age_s=10.0, base_source="from_sbp"
    )
    llh = dict(zip(("lat_deg", "lon_deg", "h_ell_m"), LLH, strict=True))
    assert PpkOptions.from_sections({}, {"base_llh": llh}) == PpkOptions(base_llh=LLH)
    with pytest.raises(ConfigError, match="unknown PPK options: elevation"):
        PpkOptions.from_sections({"elevation": 3}, {"base_from": "rinex_header"})


def test_engine_words():
    options = PpkOptions(base_ecef_m=BASE, systems=("GPS", "GAL", "QZS"), ambiguity="fix-and-hold")
    words = engine_settings(options, np.array(BASE))
    assert words["pos1-navsys"] == "25"  # 1 + 8 + 16, tools/ppk_cssrlib_demo5.conf
    assert words["pos2-armode"] == "fix-and-hold"
    assert words["ant2-postype"] == "xyz"
    assert [float(words[f"ant2-pos{k}"]) for k in (1, 2, 3)] == list(BASE)
