"""The figure of the masks."""

import numpy as np
import pandas as pd
import pytest
from PIL import Image

from thalweg.core import CoverageError
from thalweg.figures.images.photographs import example_names, mask_view, read_examples


def masks_table(n=20):
    usable = np.linspace(0.1, 0.5, n)
    return pd.DataFrame(
        {
            "image": [f"{k:02d}.jpg" for k in range(n)],
            "usable_share": usable,
            "water_share": 0.3,
            "sky_share": 0.7 - usable - 0.1,
            "hull_share": 0.1,
            "source": "automatic",
            "note": "",
        }
    )


def test_examples_shares_and_masked_parts_are_shown(rng, tmp_path, look):
    table, files = masks_table(), []
    (tmp_path / "masks").mkdir()
    for name in table["image"]:
        files.append(tmp_path / name)
        Image.fromarray(rng.integers(90, 200, (60, 80, 3)).astype(np.uint8)).save(files[-1])
        usable = np.zeros((60, 80), np.uint8)
        usable[10:30] = 255
        Image.fromarray(usable).save(tmp_path / "masks" / f"{name}.png")
    names = example_names(table)
    # 10th, 50th and 90th percentile of 20 rising shares
    assert names == ["02.jpg", "10.jpg", "17.jpg"]
    pictures = read_examples(names, files, tmp_path / "masks")
    figure = mask_view(table, pictures, title="Reach", twin=True)
    words = look.texts(figure)
    assert "Reach: median usable share 30 %, n = 20 images" in words
    assert "a: image 3, 14 % usable" in words


def test_supplied_masks_have_no_parts(rng, look):
    table = masks_table(1).assign(water_share=np.nan, sky_share=np.nan, hull_share=np.nan, source="supplied")
    picture = rng.integers(0, 255, (30, 40)).astype(np.uint8)
    figure = mask_view(table, {"00.jpg": (picture, np.ones((30, 40), bool))})
    assert not look.artists(figure, "water_share")


def test_without_a_mask_there_is_no_example():
    with pytest.raises(CoverageError):
        example_names(masks_table().assign(usable_share=np.nan))
