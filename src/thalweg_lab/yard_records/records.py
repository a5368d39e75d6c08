"""What the owner of the field writes down about it, and what is true of it."""

import json
from pathlib import Path
from typing import Any, Final

import numpy as np
import pyarrow as pa
import yaml
from scipy.spatial.transform import Rotation

from thalweg.core.frames import LocalFrame
from thalweg.core.tables import column, frame_of, table_kind, write_table
from thalweg.core.types import ArrayF
from thalweg.settings.twin.field import TwinField
from thalweg.settings.twin.sections import TwinConfig
from thalweg_lab.base.random import generator
from thalweg_lab.voyage.yard_motion import standing
from thalweg_lab.yard.furniture import ANTENNA, FLAT
from thalweg_lab.yard.layout import Field, build_field, field_of
from thalweg_lab.yard.scene import recorded_scene

KIND: Final = "thalweg twin field"
_F = pa.float64()

FIELD_POSES: Final = table_kind(
    "twin_field_poses",
    1,
    [
        column("name", pa.string(), "1", "position_1, position_2 ..."),
        column("begin_t_gps_s", _F, "s", "begin of the lidar recording, adjusted standard GPS time"),
        column("end_t_gps_s", _F, "s", "end of the lidar recording"),
        *(column(f"{a}_m", _F, "m", f"{a} of the ics origin, wcs") for a in ("east", "north", "up")),
        *(column(f"q_{a}", _F, "1", f"quaternion of R_wcs_ics, {a}, scalar last") for a in "xyzw"),
    ],
)


def simulate_field_scene(config: TwinConfig, seed: int, out_scene: Path) -> None:
    """Write the field with the boat's recording time and people as the scene of the dynamic run."""
    recorded_scene(config, seed, "run").scene.write(out_scene)


def simulate_field(
    config: TwinConfig,
    seed: int,
    frame: LocalFrame,
    *,
    out_field: Path,
    out_truth: Path,
    out_poses: Path,
) -> None:
    """Write the description of the field as its owner knows it, and the truth.

    Parameters
    ----------
    config : section ``twin`` with ``field``.
    seed : seed of the campaign.
    frame : the world frame.
    out_field : ``field.yaml``: nominal cones, certificates of the scale bars, RTK positions of the targets.
    out_truth : JSON: true cones, saddles, bars and targets, while the reference was photographed and while
        the boat was there.
    out_poses : true poses of the static positions, table kind ``twin_field_poses``.

    Raises
    ------
    ConfigError : the section ``twin.field`` is missing.
    """
    field = build_field(config, seed)
    _write_text(out_field, description(field, seed, frame))
    truth = {
        "kind": KIND,
        "version": 1,
        "frame": "wcs, metres; axes from the apex into the cone",
        "reference": _facts(field),
        "boat": _facts(build_field(config, seed, when="boat")),
        "effects": field.config.effects.model_dump(mode="json"),
    }
    _write_text(out_truth, json.dumps(truth, indent=1) + "\n")
    write_table(out_poses, frame_of(FIELD_POSES, _poses(config)), FIELD_POSES)


def description(field: Field, seed: int, frame: LocalFrame) -> str:
    """Text of ``field.yaml``.

    Certificates of bars and positions of targets carry errors of the stated sigmas; the cones are as planned.
    """
    f = field.config
    rng = generator(seed, "field certificates")
    bars, targets = [], []
    for bar in field.bars:
        wrong = f.effects.wrong_bar_by_m if f.effects.wrong_bar == bar.name else 0.0
        certified = bar.length_m + f.sigma_bar_m * rng.standard_normal() + wrong
        ends = {"from": f"{bar.markers[0]}/0", "to": f"{bar.markers[1]}/0"}
        length = {"length_m": round(float(certified), 7), "sigma_m": f.sigma_bar_m}
        bars.append({"name": bar.name, **ends, **length})
    rng = generator(seed, "field targets")
    for target, place in zip(field.targets, _target_places(field), strict=True):
        measured = place + np.asarray(f.sigma_target_m) * rng.standard_normal(3)
        lat, lon, height = (float(a) for a in frame.to_geodetic(measured))
        targets.append({
            "name": target.name, "marker": target.marker,
            "lat_deg": round(lat, 10), "lon_deg": round(lon, 10), "h_ell_m": round(height, 4),
            "sigma_m": list(f.sigma_target_m),
        })  # fmt: skip
    error = f.sigma_antenna_offset_m * float(generator(seed, "field antenna offset").standard_normal())
    facts = {
        "thalweg_field": 1,
        "markers": {
            "dictionary": "DICT_4X4_250",
            "module_m": f.module_m,
            "sizes": [{"ids": list(FLAT), "module_m": f.flat_module_m}],
        },
        "cones": [
            {
                "name": cone.name,
                "markers": [cone.markers[0], cone.markers[-1]],
                "half_angle_deg": f.half_angle_deg,
                "length_m": f.cone_length_m,
            }
            for cone in field.cones
        ],
        "scale_bars": bars,
        "targets": targets,
        "antenna": {
            "marker": ANTENNA,
            "offset_m": round(f.antenna_offset_m + error, 5),
            "sigma_m": f.sigma_antenna_offset_m,
        },
    }
    return _yaml(facts)


def _yaml(facts: dict[str, Any]) -> str:
    """Sections one after the other, each entry of a list on a line of its own."""
    lines = []
    for key, value in facts.items():
        if isinstance(value, list):
            lines.append(f"{key}:")
            lines += [f"  - {_flow(item)}" for item in value]
        else:
            lines.append(f"{key}: {_flow(value)}")
    return "\n".join(lines) + "\n"


def _flow(value: Any) -> str:
    text = yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000)
    return str(text).removesuffix("\n").removesuffix("\n...")


def _target_places(field: Field) -> list[ArrayF]:
    """True centres (3,): RTK measures what hangs there, whatever id is printed on it."""
    centres = {s.thing: s.centre_wcs_m() for s in field.sheets}
    return [centres[f"board {target.marker}"] for target in field.targets]


def _facts(field: Field) -> dict[str, Any]:
    return {
        "cones": [
            {
                "name": c.name,
                "apex_wcs_m": c.apex_wcs_m.tolist(),
                "axis_wcs": c.axis_wcs.tolist(),
                "half_angle_rad": c.half_angle_rad,
                "start_m": c.start_m,
                "length_m": c.length_m,
                "markers": list(c.markers),
            }
            for c in field.cones
        ],
        "saddles_wcs_m": {f"{m}/{k}": p.tolist() for (m, k), p in field.saddles_wcs_m().items()},
        "markers_on_cones": {str(s.marker): s.cone for s in field.sheets if s.cone is not None},
        "bars": [{"name": b.name, "markers": list(b.markers), "length_m": b.length_m} for b in field.bars],
        "targets": [
            {"name": t.name, "marker": t.marker, "centre_wcs_m": p.tolist()}
            for t, p in zip(field.targets, _target_places(field), strict=True)
        ],
        "antenna_offset_m": field.config.antenna_offset_m,
    }


def _poses(config: TwinConfig) -> dict[str, Any]:
    field: TwinField = field_of(config)
    boats = [standing(config, i + 1) for i in range(len(field.positions))]
    poses = [boat.T_wcs_ics for boat in boats]
    place = np.stack([p.shift_m for p in poses])
    q = Rotation.from_matrix(np.stack([p.R for p in poses])).as_quat()
    begin = np.array([boat.start_gps_s for boat in boats])
    return {
        "name": [f"position_{i + 1}" for i in range(len(boats))],
        "begin_t_gps_s": begin,
        "end_t_gps_s": begin + field.position_s,
        **{f"{a}_m": place[:, i] for i, a in enumerate(("east", "north", "up"))},
        **{f"q_{a}": q[:, i] for i, a in enumerate("xyzw")},
    }


def _write_text(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
