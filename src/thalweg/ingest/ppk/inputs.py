"""Input files of a PPK run: their kinds, the files that the engine reads, and checks before it runs."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from thalweg.core.errors import InputError
from thalweg.core.timescales import utc_text_from_gps
from thalweg.core.types import ArrayF
from thalweg.ingest.ppk.engine import run_worker
from thalweg.ingest.ppk.options import PpkOptions
from thalweg.ingest.ppk.rinex import RinexScan, rinex_kind, scan_rinex, whole_records
from thalweg.ingest.ppk.sbp import EPHEMERIDES, OLD_OBSERVATIONS, SbpFrames, looks_like_sbp, walk_sbp

Kind = Literal["SBP", "observation", "navigation"]

EPHEMERIS_AGE_S: Final = {
    "GPS": 7201.0,
    "GLO": 1800.0,
    "GAL": 14400.0,
    "QZS": 7201.0,
    "BDS": 21601.0,
    "SBS": 360.0,
}
"""Largest distance from the reference time at which RTKLIB uses an ephemeris (rtklib.h, MAXDTOE)."""

_CURE_ROVER: Final = "Give the rover's SBP log or RINEX observation files"
_CURE_BASE: Final = "Give base=None for the corrections inside an SBP log, or the files of the base station"


@dataclass(slots=True)
class PpkInputs:
    """Prepared files: names for the engine, scans of what they hold, and the walk through SBP logs."""

    engine_files: list[str]
    base_glob: str
    nav_files: list[str]
    rover: list[RinexScan]
    base: list[RinexScan]
    nav: list[RinexScan]
    rover_sbp: SbpFrames | None = None
    base_sbp: SbpFrames | None = None
    losses: dict[str, int] = field(default_factory=dict)
    bytes_read: int = 0
    notes: list[str] = field(default_factory=list)

    @property
    def rover_t_gps_s(self) -> ArrayF:
        """Times of all rover epochs, sorted, each once."""
        return _times(self.rover)

    @property
    def base_t_gps_s(self) -> ArrayF:
        """Times of all base epochs, sorted, each once."""
        return _times(self.base)


def kind_of_file(path: Path) -> Kind:
    """Whether a file is an SBP log, RINEX observations or RINEX navigation data.

    Raises
    ------
    InputError : it is missing, empty or none of them.
    """
    if not path.is_file():
        raise InputError("file not found", expected="an SBP log or a RINEX file", where=path)
    with path.open("rb") as stream:
        head = stream.read(65536)
    if b"RINEX VERSION" not in head[:100] and looks_like_sbp(head):
        return "SBP"
    try:
        return rinex_kind(path, head)
    except InputError as error:
        if "first line" not in error.found:
            raise
        raise InputError(
            "neither an SBP log nor a RINEX file",
            expected="SBP frames (0x55 ... CRC) or a line 'RINEX VERSION / TYPE'",
            where=path,
            cure="Export the raw observations of the receiver as RINEX 3",
        ) from error


def prepare_inputs(
    rover: Sequence[Path],
    base: Sequence[Path] | None,
    nav: Sequence[Path],
    folder: Path,
    *,
    time_limit_s: float,
) -> PpkInputs:
    """Copy or convert the files into ``folder`` under names that the engine takes as they are.

    Several files of one receiver share a wildcard: listed apart, the engine takes the second for the base.
    Damaged RINEX epochs are left out of the copy and counted; SBP files of one receiver are joined in the
    given order.

    Raises
    ------
    InputError : a file is missing, of the wrong kind, given twice, or holds no observations.
    """
    rover_kind = _role_kind(rover, "rover", ("SBP", "observation"), _CURE_ROVER)
    base_kind = None if base is None else _role_kind(base, "base", ("SBP", "observation"), _CURE_BASE)
    if base is None and rover_kind != "SBP":
        raise InputError(
            "no base files, and a RINEX rover holds no corrections",
            expected="the observation files of a base station",
            where=rover[0],
            cure=_CURE_BASE,
        )
    if nav:
        _role_kind(nav, "navigation", ("navigation",), "Give RINEX navigation files (*.nav, *.yyN, *.yyP)")
    _refuse_doubles(rover, base or (), nav)

    out = PpkInputs([], "", [], [], [], [])
    tasks: list[dict[str, Any]] = []
    if rover_kind == "SBP":
        out.rover_sbp = _join_sbp(rover, folder / "rover.sbp", "rover", out)
        _need_observations(out.rover_sbp, rover[0], base=False)
        tasks.append(_conversion(folder, "rover", ""))
    else:
        _copy_rinex(rover, folder, "rover", "obs", out)
    if base is None:
        assert out.rover_sbp is not None
        _need_observations(out.rover_sbp, rover[0], base=True)
        tasks.append(_conversion(folder, "base", "CONVBASE,BASEPOS", source="rover"))
    elif base_kind == "SBP":
        out.base_sbp = _join_sbp(base, folder / "base.sbp", "base", out)
        relayed = not out.base_sbp.observations(base=False)  # the log of a receiver that only heard the base
        _need_observations(out.base_sbp, base[0], base=relayed)
        tasks.append(_conversion(folder, "base", "CONVBASE,BASEPOS" if relayed else ""))
    else:
        _copy_rinex(base, folder, "base", "obs", out)
    _copy_rinex(nav, folder, "nav", "nav", out)
    if tasks:
        run_worker(tasks, folder, where=str(rover[0]), time_limit_s=time_limit_s)

    where_base = rover[0] if base is None else base[0]
    out.rover = _scan_all(folder, "rover_*.obs", rover[0])
    out.base = _scan_all(folder, "base_*.obs", where_base)
    nav_files = sorted(folder.glob("nav_*.nav"))
    nav_files += [p for p in sorted(folder.glob("*_sbp.nav")) if p.stat().st_size]
    out.nav = [scan for scan in map(scan_rinex, nav_files) if scan.t_gps_s.size]
    if not out.nav:
        found = "the navigation files hold no ephemeris" if nav else "no navigation file is given"
        if tasks and not nav:
            heard = sum(s.of_types(EPHEMERIDES) for s in (out.rover_sbp, out.base_sbp) if s is not None)
            found += f", and {heard} ephemeris messages of the SBP log gave none"
        raise InputError(
            found,
            expected="broadcast ephemerides of the session",
            where=nav[0] if nav else rover[0],
            cure="Give the RINEX navigation file of the receiver or of a network (BRDC) for that day",
        )
    out.base_glob = str(folder / "base_*.obs")
    out.nav_files = [str(scan.path) for scan in out.nav]
    out.engine_files = [str(folder / "rover_*.obs"), out.base_glob, *out.nav_files]
    return out


def preflight(inputs: PpkInputs, options: PpkOptions, rover_file: Path, base_file: Path) -> list[str]:
    """Check overlap in time, systems, frequencies and ephemerides; returns notes for the report.

    Raises
    ------
    InputError : rover and base do not overlap, share no requested system, or no ephemeris covers them.
    """
    rover, base = inputs.rover_t_gps_s, inputs.base_t_gps_s
    age = options.max_age_s
    notes: list[str] = []
    if rover[0] > base[-1] + age or rover[-1] < base[0] - age:
        raise InputError(
            f"rover ({_span(rover)}) and base ({_span(base)}) do not overlap in time",
            expected="base observations during the survey",
            where=f"{rover_file}, {base_file}",
            cure="Give the base files of the same hours, and check the day",
        )
    near = np.clip(np.searchsorted(base, rover, side="right") - 1, 0, None)
    lag = rover - base[near]
    uncovered = int(np.sum((lag > age) | (lag < -age)))
    if uncovered:
        notes.append(f"{uncovered} of {rover.size} rover epochs have no base observation within {age:g} s.")
    have = {name: {s for scan in scans for s in scan.systems} for name, scans in _roles(inputs)}
    have["navigation"] = {s for scan in inputs.nav for s in scan.nav_t_gps_s}
    common = set(options.systems) & have["rover"] & have["base"]
    if not common:
        raise InputError(
            f"none of the systems {', '.join(options.systems)} is in rover ({_list(have['rover'])}) and base "
            f"({_list(have['base'])})",
            expected="at least one common system",
            where=f"{rover_file}, {base_file}",
            cure="Name the systems of both receivers in the option systems",
        )
    covered = {s for s in common & have["navigation"] if _covers(inputs.nav, s, rover)}
    if not covered:
        raise InputError(
            f"no ephemeris of {_list(common)} is valid during {_span(rover)}: the navigation data hold "
            + (_nav_spans(inputs.nav) or "none"),
            expected="ephemerides at most "
            + ", ".join(f"{EPHEMERIS_AGE_S[s]:.0f} s ({s})" for s in sorted(common))
            + " away",
            where=rover_file,
            cure="Give the navigation file of that day",
        )
    for system in options.systems:
        lacking = [name for name, systems in have.items() if system not in systems]
        if lacking:
            notes.append(f"{system} is asked for but not used: it is missing in {', '.join(lacking)}.")
        elif system not in covered:
            notes.append(f"{system} is asked for but no ephemeris of it is valid during the survey.")
    n_bands = options.frequencies.count("+") + 1
    for system in sorted(covered):
        bands = set.intersection(*(_bands(scans, system) for _, scans in _roles(inputs)))
        if len(bands) < n_bands:
            text = ", ".join(sorted(bands)) or "none"
            notes.append(
                f"{system}: {options.frequencies} asked for; phase bands common to both receivers: {text}."
            )
    return notes


def _role_kind(files: Sequence[Path], role: str, allowed: tuple[Kind, ...], cure: str) -> Kind:
    if isinstance(files, str | Path) or not files:
        raise InputError(f"no {role} files", expected="a list with at least one file", cure=cure)
    kinds = [kind_of_file(Path(file)) for file in files]
    for file, kind in zip(files, kinds, strict=True):
        if kind not in allowed or kind != kinds[0]:
            name = kind if kind == "SBP" else f"RINEX {kind} data"
            raise InputError(
                f"{name} given as {role}",
                expected=f"{' or '.join(allowed)} data"
                + (", all files of one kind" if kind in allowed else ""),
                where=file,
                cure=cure,
            )
    return kinds[0]


def _refuse_doubles(rover: Sequence[Path], base: Sequence[Path], nav: Sequence[Path]) -> None:
    seen: dict[str, tuple[str, Path]] = {}
    for role, files in (("rover", rover), ("base", base), ("navigation", nav)):
        for file in files:
            with Path(file).open("rb") as stream:
                digest = hashlib.file_digest(stream, "sha256").hexdigest()
            if digest in seen:
                other_role, other = seen[digest]
                raise InputError(
                    f"the same content is given as {other_role} ({other}) and as {role}",
                    expected="different files",
                    where=file,
                    cure=_CURE_BASE if role == "base" else f"Give each {role} file once",
                )
            seen[digest] = (role, Path(file))


def _join_sbp(files: Sequence[Path], target: Path, role: str, out: PpkInputs) -> SbpFrames:
    data = b"".join(Path(file).read_bytes() for file in files)
    target.write_bytes(data)
    frames = walk_sbp(data)
    out.bytes_read += len(data)
    if frames.bytes_lost:
        out.losses[f"{role} SBP bytes outside of intact frames"] = frames.bytes_lost
        out.notes.append(
            f"{role}: {frames.bytes_lost:,} of {len(data):,} SBP bytes belong to no intact frame "
            "(cut or damaged log)."
        )
    return frames


def _need_observations(frames: SbpFrames, file: Path, *, base: bool) -> None:
    if frames.observations(base=base):
        return
    old = [name for kind, name in OLD_OBSERVATIONS.items() if frames.of_types(frozenset({kind}))]
    who = "base observations (MsgObs of sender 0)" if base else "rover observations (MsgObs)"
    raise InputError(
        f"no {who} among {frames.n_frames} messages" + (f"; it holds {', '.join(old)}" if old else ""),
        expected="MsgObs (0x004A), the raw observations",
        where=file,
        cure="Give the files of a base station"
        if base
        else "Enable raw observations in the receiver's logging",
    )


def _conversion(folder: Path, role: str, receiver_options: str, source: str = "") -> dict[str, Any]:
    return {
        "action": "convert",
        "source": str(folder / f"{source or role}.sbp"),
        "obs": str(folder / f"{role}_000.obs"),
        # Ephemerides come from the receiver that decoded them; those among the corrections are put aside.
        "nav": str(folder / (f"{role}.ignored" if source else f"{role}_sbp.nav")),
        "receiver_options": receiver_options,
    }


def _copy_rinex(files: Sequence[Path], folder: Path, role: str, suffix: str, out: PpkInputs) -> None:
    for index, file in enumerate(files):
        scan = scan_rinex(Path(file))
        data = Path(file).read_bytes()
        out.bytes_read += len(data)
        for what, n in scan.losses.items():
            key = f"{role} {what}"
            out.losses[key] = out.losses.get(key, 0) + n
        if scan.losses:
            text = ", ".join(f"{key} {n}" for key, n in scan.losses.items())
            out.notes.append(f"{role}: damaged or cut records were left out of {Path(file).name}: {text}.")
            data = whole_records(scan, data)
        (folder / f"{role}_{index:03d}.{suffix}").write_bytes(data)


def _scan_all(folder: Path, pattern: str, where: Path) -> list[RinexScan]:
    scans = [scan_rinex(path) for path in sorted(folder.glob(pattern)) if path.stat().st_size]
    if not sum(scan.t_gps_s.size for scan in scans):
        raise InputError(
            f"no epoch with observations of the {pattern.split('_')[0]}",
            expected="at least one epoch",
            where=where,
            cure="The file is cut or was logged without satellites",
        )
    return [scan for scan in scans if scan.t_gps_s.size]


def _times(scans: list[RinexScan]) -> ArrayF:
    return np.unique(np.concatenate([scan.t_gps_s for scan in scans]))


def _roles(inputs: PpkInputs) -> tuple[tuple[str, list[RinexScan]], ...]:
    return ("rover", inputs.rover), ("base", inputs.base)


def _covers(nav: list[RinexScan], system: str, t: ArrayF) -> bool:
    age = EPHEMERIS_AGE_S[system]
    reference = np.concatenate([scan.nav_t_gps_s.get(system, np.zeros(0)) for scan in nav])
    return bool(np.any((reference >= t[0] - age) & (reference <= t[-1] + age)))


def _bands(scans: list[RinexScan], system: str) -> set[str]:
    codes = [code for scan in scans for code in scan.codes.get(system, next(iter(scan.codes.values()), []))]
    return {code[:2] for code in codes if code.startswith("L")}


def _span(t: ArrayF) -> str:
    return f"{utc_text_from_gps(float(t[0]), 0)} .. {utc_text_from_gps(float(t[-1]), 0)}"


def _nav_spans(nav: list[RinexScan]) -> str:
    systems = sorted({s for scan in nav for s in scan.nav_t_gps_s})
    times = {s: np.concatenate([scan.nav_t_gps_s.get(s, np.zeros(0)) for scan in nav]) for s in systems}
    return "; ".join(f"{s} {_span(np.sort(t))}" for s, t in times.items())


def _list(names: set[str]) -> str:
    return ", ".join(sorted(names)) or "none"
