"""Defects of logs are where their report says."""

import numpy as np
import pytest

from thalweg_lab.instruments.effects import damage_file, lost_packets
from thalweg_lab.settings import TwinConfig, TwinEffects


def test_damage_is_where_the_report_says(tmp_path):
    effects = TwinConfig.of_size(
        "tiny", effects={"corrupt_bytes": 20, "cut_end_bytes": 33, "damaged_streams": ["ins"]}
    ).effects
    good = bytes(range(256)) * 20
    path = tmp_path / "log"
    path.write_bytes(good)
    assert damage_file(path, "echo", effects, np.random.default_rng(1))["corrupt_offsets"] == []
    assert path.read_bytes() == good
    facts = damage_file(path, "ins", effects, np.random.default_rng(1))
    bad = path.read_bytes()
    assert len(bad) == len(good) - 33 == len(good) - facts["cut_end_bytes"]
    changed = [i for i, (a, b) in enumerate(zip(good, bad, strict=False)) if a != b]
    assert changed == facts["corrupt_offsets"]
    assert len(changed) == 20
    assert min(changed) >= 64


@pytest.mark.parametrize(("share", "burst"), [(0.01, 5), (0.5, 1), (1.0, 5), (1.0, 1)])
def test_the_share_of_lost_packets_is_the_one_asked_for(share, burst):
    effects = TwinEffects(lost_packets=share, lost_burst=burst)
    lost = lost_packets(effects, 10_000, np.random.default_rng(3))
    # rounded to whole bursts
    assert lost.mean() == pytest.approx(share, abs=burst / 10_000)
