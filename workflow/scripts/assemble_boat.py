"""Mount of the lidar, camera-lidar orientation and a ruler's echo sounder -> one calibration of the boat."""

from pathlib import Path
from typing import Any

from thalweg.calibration import EchoPlace, assemble
from thalweg.calibration.ins_lidar import read_mount_result
from thalweg.core.calibration import Source, read_calibration, write_calibration
from thalweg.workflow import run_job


def main(
    *,
    mount: Path,
    camera_lidar: Path | None,
    boat: Path,
    run: str,
    echo_sounder: dict[str, Any] | None,
    twin: bool,
) -> None:
    found = read_mount_result(mount)
    place = None
    if echo_sounder is not None:
        place = EchoPlace.ruled_from_ins(**echo_sounder)
    relative = read_calibration(camera_lidar).pose("camera_lidar") if camera_lidar else None
    methods = ("cones from the moving boat", *(["cones and camera"] if camera_lidar else []), "ruler")
    source = Source(
        run=run,
        method=", ".join(methods),
        observations=int(found.facts["points"]),
        sigma0=float(found.facts["sigma0"]),
        twin=twin,
    )
    write_calibration(
        boat,
        assemble(
            found,
            T_ccs_scs=relative,
            antenna=found.antenna,
            echo_sounder=place,
            source=source,
            lever_ics_antenna_m=found.lever_ics_antenna_m,
        ),
    )


if "snakemake" in globals():
    run_job(main, snakemake)
