"""What is known of a field beside its points: its place in the world, how it was found, what was left out."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from thalweg.calibration.field.datum import FieldDatum
from thalweg.calibration.field.network import FieldNetwork
from thalweg.core.errors import GeometryError, InputError
from thalweg.core.rigid import Rigid

KIND: Final = "thalweg field"
VERSION: Final = 1


def write_facts(path: Path, network: FieldNetwork, datum: FieldDatum | None, notes: list[str]) -> None:
    """Write the facts of an adjusted field as JSON."""
    facts: dict[str, Any] = {"kind": KIND, "version": VERSION, "adjustment": network.report, "notes": notes}
    facts["rejected"] = network.rejected.to_dict("records")
    facts["camera_changes"] = [asdict(change) for change in network.changes]
    if network.scale is not None:
        facts["scale_bars"] = {
            "used": network.scale.used.tolist(),
            "off_mm": [_or_none(v * 1000.0) for v in network.scale.off_m],
            "sigma_off_mm": [_or_none(v * 1000.0) for v in network.scale.sigma_off_m],
        }
    facts["T_wcs_pcs"] = None
    if datum is not None:
        facts["T_wcs_pcs"] = {
            "equation": "x_wcs = T_wcs_pcs @ x_pcs",
            "matrix": datum.T_wcs_pcs.matrix.tolist(),
            "cov": datum.T_wcs_pcs.cov.tolist(),
            "cov_of": "shift in m, small rotation vector in rad, both in wcs",
        }
        facts["targets"] = {
            "table": datum.table.to_dict("records"),
            "rejected": [{"name": name, "reason": reason} for name, reason in datum.rejected],
            "sigma0": datum.sigma0,
            "redundancy": datum.redundancy,
            "sigma_scale": datum.sigma_scale,
        }
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(facts, indent=2, allow_nan=False) + "\n")


def read_facts(path: Path) -> dict[str, Any]:
    """Read what `write_facts` wrote.

    Raises
    ------
    InputError : the file is missing or something else.
    """
    if not path.is_file():
        raise InputError("file not found", expected="facts of a calibration field", where=path)
    try:
        facts = json.loads(path.read_text())
        known = (facts["kind"], facts["version"]) == (KIND, VERSION)
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"no facts of a field ({error!r})", expected=f"{KIND}, version {VERSION}", where=path
        ) from error
    if not known:
        raise InputError(
            f"{facts['kind']}, version {facts['version']}", expected=f"{KIND}, version {VERSION}", where=path
        )
    return dict(facts)


def read_place(path: Path) -> Rigid:
    """``T_wcs_pcs`` of a field with its covariance.

    Raises
    ------
    InputError : the file is missing or something else.
    GeometryError : the field has no targets, so that its place in the world is unknown.
    """
    place = read_facts(path)["T_wcs_pcs"]
    if place is None:
        raise GeometryError(
            "the field has no place in the world: its description names no RTK targets",
            expected="at least three targets",
            where=path,
            cure="Measure three markers or more by RTK and add them to the field description",
        )
    return Rigid.from_matrix(np.array(place["matrix"]), np.array(place["cov"]))


def _or_none(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
