"""Result tables of a campaign -> key numbers in one table."""

from pathlib import Path

from thalweg.accuracy import summary_table
from thalweg.workflow import run_job


def main(
    *,
    streams: Path,
    trajectory: Path,
    positions: Path,
    counts: list[Path],
    images: list[Path],
    soundings: list[Path],
    bed: list[Path],
    reference: list[Path],
    truth: list[Path],
    summary: Path,
) -> None:
    summary_table(
        streams,
        trajectory,
        counts[0] if counts else None,
        positions=positions,
        images=images[0] if images else None,
        soundings=soundings[0] if soundings else None,
        bed=bed[0] if bed else None,
        reference=reference[0] if reference else None,
        truth=truth[0] if truth else None,
    ).to_csv(summary, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
