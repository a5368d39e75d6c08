"""Damaged campaign files: no mistake hides another, and no file stops the reader with a bare error."""

import pytest

from thalweg.settings.load import load_campaign
from thalweg.settings.messages import CampaignError


def test_duplicate_key_does_not_hide_other_mistakes(write):
    path = write()
    path.write_text(path.read_text().replace("  seed: 5\n", "  seed: 5\n  seed: 6\n  crs_: x\n"))
    with pytest.raises(CampaignError) as caught:
        load_campaign(path)
    assert [m.dotted for m in caught.value.mistakes] == ["campaign.seed", "campaign.crs_"]


def test_fuzz_campaign_files(write, rng, fuzz_count):
    """Whatever stands in the file: a campaign or a list of mistakes, never another error."""
    path = write()
    good = path.read_bytes()
    words = [*b"* &a !!int [ { : - ~ .nan 1e999 << |".split(), b"\t", b"\x00", b": "]
    loaded = unplaced = 0
    for _ in range(fuzz_count):
        data = bytearray(good)
        for _ in range(int(rng.integers(1, 4))):
            at = int(rng.integers(0, len(data) - 1))
            match rng.integers(0, 5):
                case 0:
                    data[at] ^= 1 << int(rng.integers(0, 8))
                case 1:
                    del data[at + 2 : at + int(rng.integers(3, 30))]
                case 2:
                    data[at:at] = words[int(rng.integers(0, len(words)))]
                case 3:
                    data[at:at] = data[at : at + int(rng.integers(1, 60))]
                case _:
                    del data[at + 2 :]
        path.write_bytes(bytes(data))
        try:
            load_campaign(path)
            loaded += 1
        except CampaignError as error:
            placed = sum(str(path) in str(mistake) for mistake in error.mistakes)
            unplaced += len(error.mistakes) - placed if placed else 1
    assert loaded < fuzz_count
    assert unplaced == 0, "each mistake names its file"
