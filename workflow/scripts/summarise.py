"""Result tables of a campaign -> key numbers in one table."""

from pathlib import Path

from thalweg.accuracy import summary_table
from thalweg.workflow import run_job


def main(
    *,
    streams: Path,
    trajectory: Path,
    positions: Path,
    counts: Path | None,
    images: Path | None,
    soundings: Path | None,
    bed: Path | None,
    reference: Path | None,
    truth: Path | None,
    summary: Path,
) -> None:
    summary_table(
        streams,
        trajectory,
        counts,
        positions=positions,
        images=images,
        soundings=soundings,
        bed=bed,
        reference=reference,
        truth=truth,
    ).to_csv(summary, index=False)


if "snakemake" in globals():
    run_job(main, snakemake)
