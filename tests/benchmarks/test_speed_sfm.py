"""Time and memory of features and matching for images of 2, 8 and 16 megapixels.

Photographs of `tests/images/test_sfm_roma.py` scaled to these sizes; each run is a program of its own,
so that its peak memory is that of the run. Seconds are those of the processor, one thread.
"""

import json
import subprocess
import sys

import pytest
from PIL import Image

from tests.benchmarks import turns

pytestmark = [pytest.mark.slow, pytest.mark.real]

N_IMAGES = 4

RUN = (
    turns.MEASURES
    + """
import numpy as np
from thalweg.images.sfm.features import extract_features
from thalweg.settings.sections.images import FeatureSettings
from thalweg.images.sfm.matching import match_images

images = sorted(Path(sys.argv[1]).glob("*.jpg"))
settings = FeatureSettings(max_size_px=int(sys.argv[2]), double_size=sys.argv[3] == "True")
extract_features(images[:0], settings=settings)
idle = 1000 * peak_gb()
start = time.process_time()
features = extract_features(images, settings=settings)
extraction_s, extraction_mb = time.process_time() - start, 1000 * peak_gb()
start = time.process_time()
matches = match_images(features, images)
print(json.dumps({
    "features": float(np.diff(features.start).mean()), "idle_mb": idle,
    "extraction_s": extraction_s / len(images), "extraction_mb": extraction_mb,
    "pair_s": (time.process_time() - start) / len(matches.pairs), "peak_mb": 1000 * peak_gb(),
}))
"""
)


@pytest.mark.parametrize(
    ("megapixels", "max_size_px", "double_size"),
    [(2, 20_000, True), (8, 20_000, True), (16, 20_000, True), (16, 3200, True), (16, 20_000, False)],
)
def test_time_and_memory(data_dir, tmp_path, megapixels, max_size_px, double_size):
    width = round((megapixels * 1e6 * 1.5) ** 0.5)
    for path in sorted((data_dir / "dbat_roma/dbat/images/roma").glob("*.JPG"))[:N_IMAGES]:
        with Image.open(path) as image:
            size = (width, round(width / 1.5))
            image.convert("L").resize(size, Image.Resampling.LANCZOS).save(
                tmp_path / f"{path.stem}.jpg", quality=90
            )
    words = [sys.executable, "-c", RUN, str(tmp_path), str(max_size_px), str(double_size)]
    run = subprocess.run(words, capture_output=True, text=True, check=True)
    found = json.loads(run.stdout)
    print(
        f"{megapixels:3d} MP, searched up to {max_size_px} px, double {double_size}: "
        f"{found['features']:.0f} features, {found['extraction_s']:.1f} s an image, "
        f"{found['extraction_mb']:.0f} MB (idle {found['idle_mb']:.0f}); "
        f"{found['pair_s']:.2f} s a pair, {found['peak_mb']:.0f} MB"
    )
    assert found["extraction_mb"] < 8000


MAPPER = (
    turns.MEASURES
    + """
import numpy as np
from tests.benchmarks.voyage_scene import voyage
from thalweg.images.sfm.mapping import map_images

n = int(sys.argv[1])
matches = voyage(n)
begin = time.process_time()
mapped = map_images(matches)
print(json.dumps({
    "features": float(np.diff(matches.start).mean()), "s": time.process_time() - begin,
    "marks": len(mapped.pieces[0].mark_image), "images": len(mapped.pieces[0].images),
    "peak_mb": 1000 * peak_gb(), "notes": mapped.facts["notes"],
}))
"""
)


@pytest.mark.parametrize("images", [80, 160, 320])
def test_time_of_the_mapper(images):
    """How the time of the one job that cannot be dealt out grows with the number of images."""
    run = subprocess.run(
        [sys.executable, "-c", MAPPER, str(images)], capture_output=True, text=True, check=True
    )
    found = json.loads(run.stdout)
    print(
        f"{images} images of {found['features']:.0f} features: {found['s']:.0f} s, "
        f"{found['marks']} marks, {found['peak_mb']:.0f} MB {found['notes']}"
    )
    assert found["images"] == images
