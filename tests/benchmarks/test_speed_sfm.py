"""Time and memory of features and matching for images of 2, 8 and 16 megapixels.

Photographs of `tests/images/test_sfm_roma.py` scaled to these sizes; each run is a program of its own,
so that its peak memory is that of the run. Seconds are those of the processor, one thread.
"""

import json
import subprocess
import sys
from pathlib import Path

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
def test_time_and_memory(
    data_dir: Path, tmp_path: Path, megapixels: int, max_size_px: int, double_size: bool
) -> None:
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
from thalweg.core.camera import Camera
from thalweg.images.sfm.colmap import start_given
from thalweg.images.model.files import Picture
from thalweg.images.sfm.mapping import map_images
from thalweg.images.sfm.matching import Matches

n, rng = int(sys.argv[1]), np.random.default_rng(1)
camera = Camera(model="perspective", size_px=(4590, 3440),
                parameters=np.array([3700.0, 3700, 2295, 1720, 0, 0, 0, 0, 0]))
# a boat 20 m off the bank, an image a metre, with steps of half a metre to and from the bank
centre = np.stack([np.arange(n) * 1.0, 0.3 * np.sin(np.arange(n)), 0.5 * np.cos(0.7 * np.arange(n))], axis=1)
points = np.stack([rng.uniform(-15, n + 15, 120 * (n + 30)), rng.uniform(-6, 3, 120 * (n + 30)),
                   rng.uniform(18, 24, 120 * (n + 30))], axis=1)
seen = []
for k in range(n):
    xy = camera.project(points - centre[k])
    inside = np.flatnonzero(((xy > 0) & (xy < camera.size_px)).all(axis=1))
    # a place is found again for some metres, and not always
    inside = inside[(np.abs(points[inside, 0] - centre[k, 0]) < 12) & (rng.random(len(inside)) < 0.3)]
    seen.append((inside, xy[inside] + 0.4 * rng.standard_normal((len(inside), 2))))
pairs = np.array([(a, b) for a in range(n) for b in range(a + 1, min(a + 11, n))])
common = [np.column_stack(np.intersect1d(seen[a][0], seen[b][0], return_indices=True)[1:]) for a, b in pairs]
start = np.concatenate([[0], np.cumsum([len(s[0]) for s in seen])])
place = np.concatenate([np.column_stack([xy, np.full(len(xy), 2.0)]) for _, xy in seen]).astype(np.float32)
matches = Matches(
    pictures=tuple(Picture(name=f"{k:04d}.jpg", size_px=camera.size_px) for k in range(n)),
    order=np.arange(n), starts=(start_given(camera),), camera=np.zeros(n, np.int64), start=start, place=place,
    pairs=pairs, n_matches=np.array([len(c) for c in common]), config=np.full(len(pairs), 2),
    geometry=np.full((len(pairs), 4, 3, 4), np.nan),
    pair_start=np.concatenate([[0], np.cumsum([len(c) for c in common])]),
    common=np.concatenate(common).astype(np.uint32), facts={"max_size_px": 3200, "notes": []},
)
begin = time.process_time()
mapped = map_images(matches)
print(json.dumps({
    "features": float(np.diff(start).mean()), "s": time.process_time() - begin,
    "marks": len(mapped.pieces[0].mark_image), "images": len(mapped.pieces[0].images),
    "peak_mb": 1000 * peak_gb(),
}))
"""
)


@pytest.mark.parametrize("images", [40, 80, 160])
def test_time_of_the_mapper(images: int) -> None:
    """How the time of the one job that cannot be dealt out grows with the number of images."""
    run = subprocess.run(
        [sys.executable, "-c", MAPPER, str(images)], capture_output=True, text=True, check=True
    )
    found = json.loads(run.stdout)
    print(
        f"{images} images of {found['features']:.0f} features: {found['s']:.0f} s, {found['marks']} marks, "
        f"{found['peak_mb']:.0f} MB"
    )
    assert found["images"] == images
