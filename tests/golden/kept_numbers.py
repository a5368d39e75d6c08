"""Every number that small campaigns give, in tables that are kept: no change of code moves one unseen.

    python tests/golden/kept_numbers.py          # runs the campaigns twice and writes the tables anew
    python tests/golden/kept_numbers.py A B      # the same, where they have run in these two folders
    python tests/golden/kept_numbers.py C        # wider limits for what the same code moved on this processor

The campaigns are four of the digital twin, and the examples of real recordings where these are there.
One row for each column of a table, dimension of a cloud, band of a raster and value of a document: how many
are finite, their mean and standard deviation, and the share by which they may differ. Other tests say why a
number is right; these tables say that it is the one of yesterday, also where no other test looks. A change
that is meant to move results brings its tables in the same commit: their difference is what moved.

Another processor rounds otherwise. That turns single pixels of the twin's pictures, and the image block finds
other tie points. So the campaigns run a second time with the plainest instructions, and a file in which that
moves a value by more than `SHARE` gets wider limits, ten times what was seen.
"""

import os
import re
import runpy
import shutil
import subprocess
import sys
import tempfile
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
import pandas as pd

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.golden.values import VALUES, files

CAMPAIGNS: Final[dict[str, tuple[str, ...]]] = {
    "tiny": (),
    "field_tiny": (),
    "tiny_change": (),
    "basin_tiny": ("triangulation/panels.csv", "accuracy/light_sheet_truth.csv"),
}
"""Campaigns of the digital twin that the suite runs, and up to which results if not to all."""
EXAMPLES: Final = "config/campaigns/examples"
RECORDINGS: Final[dict[str, tuple[str, ...]]] = {
    "cloud": ("index.html",),
    "finished_photographs": ("index.html",),
    "fixed_camera": ("index.html",),
    "gnss": ("index.html", "orientation/track.geojson"),  # all builds the track; no page needs it
    "photograph_positions": ("index.html",),
    "photographs": ("index.html",),
    "lidar": ("lidar/points.laz",),  # pictures of a cloud are those of every survey
    "lidar_without_pps": ("lidar/points.laz",),
}
"""Examples of real recordings that the suite runs, and up to which results."""
SEARCHED_PX: Final = {"photographs": 600, "photograph_positions": 450}
"""Pixels of the longer side in which features are searched: enough to orient these, in less time."""
REPOSITORY: Final = Path(__file__).resolve().parents[2]
DATA: Final = Path(os.environ.get("THALWEG_DATA", REPOSITORY.parent / "shared/data"))
COPIED: Final = ("Snakefile", "config", "envs", "profiles", "resources", "src", "workflow")
PLAIN: Final = {
    "NUMBA_CPU_NAME": "generic",
    "OPENBLAS_CORETYPE": "Nehalem",
    "NPY_DISABLE_CPU_FEATURES": "AVX512F AVX512CD AVX512_SKX AVX512_CLX AVX512_CNL AVX512_ICL AVX2 FMA3",
}
"""Environment of a processor with few instructions."""
KEPT: Final = Path(__file__).resolve().parent / "numbers"
SHARE: Final = 1e-3
"""Share of its standard deviation by which a mean or a standard deviation may differ, and of itself a single
value: a point at a threshold falls to the other side."""
LOOSE: Final = (10.0, 0.1)
"""In files that depend on the processor: times what its change moved, and at least this share."""
ROUNDING: Final = 1e-9
"""And share of its size: times since 1980, map coordinates."""
CANCELLED: Final = 1e-12
"""And this much, whatever the size: 0 by one processor is 2e-13 mm by another (camera of `basin_tiny`)."""
PICTURES: Final = {".png", ".bag"}


def numbers_of(folder: Path, names: Collection[str] = ()) -> pd.DataFrame:
    """Table of the results in a folder, or of these files of it: n, mean, sd by file and value."""
    rows = [
        (file, name, *_moments(values))
        for file in sorted(names or files(folder))
        if Path(file).suffix in {*VALUES, ".csv"} - PICTURES
        for name, values in _arrays(folder / file).items()
    ]
    return pd.DataFrame(rows, columns=["file", "value", "n", "mean", "sd"]).set_index(["file", "value"])


def _arrays(path: Path) -> dict[str, Any]:
    """Arrays of a file by name; what a list of a document holds is one array."""
    if path.suffix == ".csv":
        table = pd.read_csv(path, comment="#", low_memory=False)
        return {str(name): column.to_numpy() for name, column in table.items()}
    lists = defaultdict[str, list[Any]](list)
    for name, values in VALUES[path.suffix](path).items():
        lists[re.sub(r"\[\d+\]", "[]", name)].append(np.ravel(values))
    return {name: np.concatenate(parts) for name, parts in lists.items()}


def _moments(values: Any) -> tuple[int, float, float]:
    """Count, mean, standard deviation of what is finite; of words how many, and how many different ones."""
    values = np.ravel(values)
    if values.dtype.kind == "M":
        values = values.astype("datetime64[ns]").astype(np.int64) / 1e9
    if values.dtype.kind not in "fiub":
        words = [str(each) for each in values if not np.all(pd.isna(each))]
        return len(words), len({*words}), 0.0
    finite = values[np.isfinite(values)].astype(float)
    return (len(finite), float(finite.mean()), float(finite.std())) if len(finite) else (0, 0.0, 0.0)


def shares(found: pd.DataFrame, plain: pd.DataFrame) -> pd.Series:
    """Share by which each value may differ, from the same campaign with plainer instructions; inf: any."""
    off = _off(found, plain.reindex(found.index)).fillna(np.inf)
    files = found.index.get_level_values("file")
    new = plain.index.difference(found.index).get_level_values("file")
    unstable = (off > SHARE).groupby(files).transform("any") | files.isin(new)
    return (LOOSE[0] * off).clip(lower=LOOSE[1]).where(unstable, SHARE)


def wider(kept: pd.DataFrame, found: pd.DataFrame) -> pd.Series:
    """Shares of a table that is kept, wider where the same code on another processor broke them."""
    off = _off(kept, found).reindex(kept.index)
    return kept["share"].mask(off > kept["share"], shares(kept, found))


def _off(kept: pd.DataFrame, found: pd.DataFrame) -> pd.Series:
    """By which share of its standard deviation, or of itself, each value differs."""
    size = kept["mean"].abs()
    scale = kept["sd"].where(kept["sd"] > 0, size)
    far = np.maximum((found["mean"] - kept["mean"]).abs(), (found["sd"] - kept["sd"]).abs())
    beyond = (far - np.maximum(ROUNDING * size, CANCELLED)).clip(lower=0.0)
    of_count = (found["n"] - kept["n"]).abs() / kept["n"].clip(lower=1)
    return np.maximum((beyond / scale).where(beyond > 0, 0.0), of_count)


def moved(kept: pd.DataFrame, found: pd.DataFrame) -> Iterator[str]:
    """What is not as kept, a line each."""
    steady = {file for (file, _), share in kept["share"].items() if share == SHARE}
    files = [set(table.index.get_level_values("file")) for table in (kept, found)]
    for file, value in kept.index.symmetric_difference(found.index):
        if file in steady or file not in files[0] & files[1]:
            yield f"{file}: {value}: only {'kept' if (file, value) in kept.index else 'found'}"
    before, now = kept.align(found, join="inner", axis=0)
    for file, value in before.index[_off(before, now) > before["share"]]:
        a, b = (table.loc[(file, value)] for table in (before, now))
        yield (
            f"{file}: {value}: n {a['n']:.0f} -> {b['n']:.0f}, mean {a['mean']:.9g} -> {b['mean']:.9g}, "
            f"standard deviation {a['sd']:.6g} -> {b['sd']:.6g}"
        )


def moved_since_kept(folder: Path) -> list[str]:
    """What has moved in the results of a campaign; where that is meant: ``make numbers``."""
    return [*moved(read_kept(folder.name), numbers_of(folder))]


def read_kept(campaign: str) -> pd.DataFrame:
    """Table that is kept of a campaign."""
    return pd.read_csv(KEPT / f"{campaign}.csv", index_col=["file", "value"], keep_default_na=False)


def run_campaigns(
    house: Path,
    environment: Mapping[str, str],
    snakemake: Sequence[str] = ("-m", "snakemake"),
    more: Sequence[str] = (),
) -> None:
    """Run the campaigns in a new copy of the checkout.

    Parameters
    ----------
    house : folder to make.
    environment : variables beside those of this process.
    snakemake : how Python starts Snakemake.
    more : further options of it.
    """
    house.mkdir(parents=True)
    for name in COPIED:
        copy = shutil.copytree if (REPOSITORY / name).is_dir() else shutil.copy
        copy(REPOSITORY / name, house / name)
    variables = {**os.environ, "PYTHONPATH": str(house / "src"), **environment}
    chosen = [
        (campaign, [f"results/{campaign}/{name}" for name in names]) for campaign, names in CAMPAIGNS.items()
    ]
    if DATA.is_dir():
        chosen.append(with_examples(house, DATA))
    for campaign, targets in chosen:
        words = ["--cores", "2", "--quiet", "all", *more, "--config", f"campaign={campaign}", "--", *targets]
        subprocess.run([sys.executable, *snakemake, *words], cwd=house, env=variables, check=True)


def with_examples(house: Path, data: Path) -> tuple[str, list[str]]:
    """Make the files of the examples in a copy of the checkout.

    Returns
    -------
    ``campaign`` of all of them, and what Snakemake is to make.
    """
    runpy.run_path(str(house / EXAMPLES / "prepare.py"))["main"](data)
    for name, size_px in SEARCHED_PX.items():
        path = house / EXAMPLES / f"{name}.yaml"
        path.write_text(path.read_text().replace("max_size_px: 1000", f"max_size_px: {size_px}"))
    files = ",".join(f"{EXAMPLES}/{name}.yaml" for name in RECORDINGS)
    return f"[{files}]", [f"results/{name}/{made}" for name, all_of in RECORDINGS.items() for made in all_of]


def main(folders: Sequence[Path]) -> None:
    """Write the tables; ``folders``: of campaigns by this processor, and with plain instructions; or one.

    One folder is of some of the campaigns by another processor: limits that it breaks become wider.
    """
    with tempfile.TemporaryDirectory() as scratch:
        if not folders:
            folders = [Path(scratch, "as_it_is"), Path(scratch, "plain")]
            run_campaigns(folders[0], {})
            run_campaigns(folders[1], {**PLAIN, "NUMBA_CACHE_DIR": f"{scratch}/kernels"})
        KEPT.mkdir(exist_ok=True)
        known = [*CAMPAIGNS, *RECORDINGS] if DATA.is_dir() else [*CAMPAIGNS]
        another = len(folders) == 1
        for campaign in known:
            found = [
                numbers_of(each) for folder in folders if (each := folder / "results" / campaign).is_dir()
            ]
            if not found:
                continue
            table, other = (read_kept(campaign), found[0]) if another else found
            share = wider(table, other) if another else shares(table, other)
            table["share"] = share.map("{:.2g}".format)
            table["sd"] = table["sd"].map("{:.6g}".format)
            table.to_csv(KEPT / f"{campaign}.csv", float_format="%.10g")


if __name__ == "__main__":
    main([Path(folder) for folder in sys.argv[1:]])
