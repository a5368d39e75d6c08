"""The reference points of a calibration field as files: a table for people, the full covariance beside it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import pandas as pd
from numpy.typing import ArrayLike

from thalweg.calibration import mark_name, parse_mark
from thalweg.core import ArrayF, InputError, require_file

POINT_COLUMNS: Final = ("mark", "x_m", "y_m", "z_m", "sigma_x_m", "sigma_y_m", "sigma_z_m")


@dataclass(frozen=True, slots=True, kw_only=True)
class FieldPoints:
    """Saddles of a field: (marker, corner), coordinates (n, 3) in pcs, joint covariance (3n, 3n)."""

    points: tuple[tuple[int, int], ...]
    points_pcs: ArrayF
    cov: ArrayF

    @property
    def index(self) -> dict[tuple[int, int], int]:
        """Place of each (marker, corner)."""
        return {point: i for i, point in enumerate(self.points)}

    @property
    def sigma_m(self) -> ArrayF:
        """(n, 3) standard deviations."""
        return np.sqrt(np.maximum(np.diag(self.cov), 0.0)).reshape(-1, 3)

    def centre(self, marker: int) -> tuple[ArrayF, ArrayF]:
        """Mean (3,) of the four saddles of a marker, and its covariance.

        Raises
        ------
        InputError : not all four are among the points.
        """
        at = [i for i, (m, _) in enumerate(self.points) if m == marker]
        if len(at) != 4:
            raise InputError(
                f"{len(at)} of the four saddles of marker {marker} were measured",
                expected="all four: its centre is their mean",
                cure=f"Take more pictures that show marker {marker}",
            )
        mean = np.tile(np.eye(3), 4) / 4
        return self.points_pcs[at].mean(axis=0), mean @ self.cov_of(at) @ mean.T

    def cov_of(self, at: ArrayLike) -> ArrayF:
        """Joint covariance (3k, 3k) of the coordinates of some points (k,)."""
        rows = (3 * np.asarray(at, np.int64)[:, None] + np.arange(3)).ravel()
        return self.cov[np.ix_(rows, rows)]

    def without(self, markers: set[int]) -> "FieldPoints":
        """The points of all other markers."""
        keep = [i for i, (m, _) in enumerate(self.points) if m not in markers]
        return FieldPoints(
            points=tuple(self.points[i] for i in keep),
            points_pcs=self.points_pcs[keep],
            cov=self.cov_of(keep),
        )

    def table(self) -> pd.DataFrame:
        """Mark, coordinates and sigmas."""
        names = [mark_name(*p) for p in self.points]
        values = np.column_stack([self.points_pcs, self.sigma_m])
        table = pd.DataFrame(values, columns=list(POINT_COLUMNS[1:]))
        table.insert(0, "mark", names)
        return table


def covariance_file(table: Path) -> Path:
    """Where the full covariance of a table of points lies."""
    return table.with_suffix(".npz")


def write_points(path: Path, points: FieldPoints, table: pd.DataFrame | None = None) -> None:
    """Write the table (CSV; ``table`` if it has further columns) and the covariance beside it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    frame = points.table() if table is None else table
    # a tenth of a micrometre; the exact numbers stand with the covariance
    frame.to_csv(path, index=False, float_format="%.7f")
    with covariance_file(path).open("wb") as file:
        np.savez(file, points=np.array(points.points, np.int64), points_pcs=points.points_pcs, cov=points.cov)


def read_points(path: Path) -> FieldPoints:
    """Read what `write_points` wrote; a table without its covariance counts with the table's sigmas alone.

    Raises
    ------
    InputError : the file is missing, lacks columns, or does not fit the covariance beside it.
    """
    require_file(path, "reference points of a field")
    table = pd.read_csv(path)
    missing = [name for name in POINT_COLUMNS if name not in table.columns]
    if missing:
        raise InputError(f"columns missing: {missing}", expected=", ".join(POINT_COLUMNS), where=path)
    points = tuple(parse_mark(str(name)) for name in table["mark"])
    xyz = table[["x_m", "y_m", "z_m"]].to_numpy(np.float64)
    beside = covariance_file(path)
    if not beside.is_file():
        sigma = table[["sigma_x_m", "sigma_y_m", "sigma_z_m"]].to_numpy(np.float64)
        return FieldPoints(points=points, points_pcs=xyz, cov=np.diag(np.square(sigma).ravel()))
    with np.load(beside) as stored:
        same = tuple(map(tuple, stored["points"].tolist())) == points
        if not same or not np.allclose(stored["points_pcs"], xyz, atol=1e-6):
            raise InputError(
                "the covariance belongs to other points",
                expected=f"those of {path.name}",
                where=beside,
                cure="Adjust the field again, or delete this file to use the sigmas alone",
            )
        return FieldPoints(points=points, points_pcs=stored["points_pcs"], cov=stored["cov"])
