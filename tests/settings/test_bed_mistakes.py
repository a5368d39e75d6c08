"""A surveyed bed in a campaign file."""

import pytest

from thalweg.settings.load import CampaignError, load_campaign

BED = "east_m,north_m,h_ell_m,sigma_m\n1,2,3,0.02\n"


def test_a_bed_is_a_stream(write, survey):
    (survey / "raw/bed_1.csv").write_text(BED)
    (survey / "raw/bed_2.csv").write_text(BED)
    campaign = load_campaign(write("logs.bed: [raw/bed_*.csv]"))
    assert [p.name for p in campaign.log_files("bed")] == ["bed_1.csv", "bed_2.csv"]


def test_a_geoid_needs_name_and_sigma(write, survey):
    (survey / "raw/geoid.gtx").write_bytes(b"grid")
    geoid = "logs.geoid: [raw/geoid.gtx]"
    named = "name: DHHN2016, sigma_separation_m: 0.02"
    campaign = load_campaign(write(f"{{{geoid}, fusion.vertical: {{{named}}}}}"))
    assert [p.name for p in campaign.log_files("geoid")] == ["geoid.gtx"]
    with pytest.raises(CampaignError, match=r"logs\.geoid.*without name and sigma"):
        load_campaign(write(geoid))
    with pytest.raises(CampaignError, match=r"logs\.geoid.*beside a single separation"):
        load_campaign(write(f"{{{geoid}, fusion.vertical: {{{named}, separation_m: 45.0}}}}"))


def test_a_bed_needs_soundings(write, survey):
    (survey / "raw/bed.csv").write_text(BED)
    with pytest.raises(CampaignError, match=r"logs\.bed.*a surveyed bed without soundings"):
        load_campaign(write("{logs.bed: [raw/bed.csv], logs.depth: <removed>}"))


@pytest.mark.parametrize("yard", ["size: field_tiny", "field: {}"])
def test_a_yard_has_no_river_bed(write, yard):
    with pytest.raises(CampaignError, match=r"twin\.echo\.bed_survey.*no river bed"):
        load_campaign(write(f"{{logs: <removed>, twin: {{{yard}, echo: {{bed_survey: true}}}}}}"))
