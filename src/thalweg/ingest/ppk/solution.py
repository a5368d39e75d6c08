"""Post-processed kinematic positions from raw observations of a rover and a base, by RTKLIB (pyrtklib5).

The engine runs in a child process under a time limit: crashes and endless runs become an InputError. Inputs
are checked before it starts, and what it was told is read back and compared. Positions are those of the rover
antenna's phase centre, in the frame of the base position.
"""

import hashlib
import json
import re
import signal
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import pandas as pd

from thalweg.core import (
    ArrayF,
    ConfigError,
    InputError,
    ecef_of,
    geodetic_of,
    missing_package,
    read_json,
    require_file,
    rotation_ecef_enu,
    utc_text_from_gps,
)
from thalweg.ingest import IntegrityReport
from thalweg.ingest.framing import SKIPPED
from thalweg.ingest.ppk import worker as ppk_worker
from thalweg.ingest.ppk.options import AUTO_SYSTEMS, PpkOptions, ecef_fault, engine_settings
from thalweg.ingest.ppk.residuals import code_factors, phase_factor, read_residuals
from thalweg.ingest.ppk.rinex import (
    SYSTEM_OF_LETTER,
    RinexScan,
    losses_in_words,
    rinex_kind,
    scan_rinex,
    whole_records,
)
from thalweg.ingest.ppk.trust import read_solution, replace_covariances, trust_fixes
from thalweg.ingest.recorders import RAW_OBSERVATIONS, ubx_frames, ubx_share
from thalweg.ingest.sbp import SbpRecords, base_positions, collect, find_messages

# ---------------------------------------------------------------- the engine behind a process border

# Imported for its path only: so an edit of the worker counts as an edit of what runs it.
WORKER = Path(ppk_worker.__file__)


@dataclass(frozen=True, slots=True)
class EngineAnswer:
    """Version of the engine, one answer a task, and what the C code printed."""

    engine: str
    answers: list[dict[str, Any]]
    output: str


def engine_version() -> str:
    """Name and version of the binding, "" if it is not installed."""
    try:
        return f"pyrtklib5 {version('pyrtklib5')}"
    except PackageNotFoundError:
        return ""


def run_worker(
    tasks: Sequence[Mapping[str, Any]],
    folder: Path,
    *,
    where: str,
    time_limit_s: float,
    worker: Path = WORKER,
) -> EngineAnswer:
    """Run tasks (see `thalweg.ingest.ppk.worker`) in a child process.

    Parameters
    ----------
    tasks : dictionaries with "action" and the arguments of that action.
    folder : temporary folder of the run.
    where : the users' files, for messages.
    time_limit_s : the child is killed after that.
    worker : script of the child; the tests put a crashing one here.

    Raises
    ------
    UnsupportedError : pyrtklib5 is not installed.
    InputError : the child crashed, failed or ran too long; the text holds what it printed.
    """
    if not engine_version():
        raise missing_package(ModuleNotFoundError(name="pyrtklib5"))
    job, answer, log = folder / "job.json", folder / "answer.json", folder / "engine.log"
    job.write_text(json.dumps({"tasks": list(tasks)}))
    answer.unlink(missing_ok=True)
    command = [sys.executable, "-P", str(worker), str(job), str(answer)]
    cure = "Check the input files with 'thalweg describe', shorten the session or leave out damaged files"
    try:
        # Into a file, not a pipe: the engine prints a line of progress for every epoch.
        with log.open("wb") as sink:
            done = subprocess.run(
                command,
                stdin=subprocess.DEVNULL,
                stdout=sink,
                stderr=subprocess.STDOUT,
                cwd=folder,
                timeout=time_limit_s,
                check=False,
            )
    except subprocess.TimeoutExpired as error:
        raise InputError(
            f"the RTKLIB engine did not finish within {time_limit_s:g} s; it printed: {_tail(log)}",
            where=where,
            cure="Raise time_limit_s for a long session, or look for a damaged file with 'thalweg describe'",
        ) from error
    if done.returncode != 0 or not answer.is_file():
        code = done.returncode
        names = {int(each): each.name for each in signal.Signals}
        how = (
            f"crashed with {names.get(-code, f'signal {-code}')}"
            if code < 0
            else f"ended with exit code {code}"
        )
        raise InputError(f"the RTKLIB engine {how}; it printed: {_tail(log)}", where=where, cure=cure)
    result = read_json(answer)
    return EngineAnswer(result["engine"], result["answers"], _tail(log))


def write_settings(path: Path, settings: Mapping[str, str]) -> None:
    """Write an option file of RTKLIB."""
    path.write_text("".join(f"{key:18s} ={value}\n" for key, value in settings.items()))


def check_settings(path: Path, settings: Mapping[str, str]) -> None:
    """Compare the settings that the engine read back with those that were asked for.

    Raises
    ------
    ConfigError : the engine took another value; it replaces words that it does not know without a message.
    """
    text = path.read_text(errors="replace") if path.is_file() else ""
    taken = {key: value.strip() for key, value in re.findall(r"(?m)^(\S+)[^\S\n]*=([^#\n]*)", text)}
    wrong = [
        f"{key}: asked {value!r}, taken {taken.get(key, 'nothing')!r}"
        for key, value in settings.items()
        if not _same(taken.get(key, ""), value)
    ]
    if wrong:
        raise ConfigError(
            "the RTKLIB engine did not take these settings: " + "; ".join(wrong),
            expected="the values asked for",
            cure=f"Use the tested engine, pyrtklib5 0.2.8 (installed: {engine_version()})",
        )


def _same(taken: str, asked: str) -> bool:
    try:
        # saveopts prints 15 digits; 1e-11 of an earth-centred coordinate is 0.06 mm.
        return abs(float(taken) - float(asked)) <= 1e-11 * max(1.0, abs(float(asked)))
    except ValueError:
        return taken == asked


def _tail(log: Path, limit: int = 1500) -> str:
    """The last lines that the engine printed; progress lines, which end in a carriage return, once."""
    if not log.is_file():
        return "nothing"
    text = log.read_bytes()[-200_000:].decode("utf-8", "replace")
    lines = [line.strip() for line in re.split(r"[\r\n]+", text) if line.strip()]
    progress = [bool(_PROGRESS.match(line)) for line in lines]
    kept = [
        a
        for a, this, after in zip(lines, progress, [*progress, False][1:], strict=True)
        if not (this and after)
    ]
    return " | ".join(kept)[-limit:] or "nothing"


_PROGRESS: Final = re.compile(r"processing|reading|scanning|\d{4}/\d\d/\d\d")


# ---------------------------------------------------------------- SBP logs as PPK sees them

_OBSERVATIONS: Final = 0x004A
OLD_OBSERVATIONS: Final = {0x0043: "MsgObsDepB", 0x0045: "MsgObsDepA", 0x0049: "MsgObsDepC"}
EPHEMERIDES: Final = frozenset(
    {0x001A, 0x0046, 0x0047, 0x0080, 0x0081, 0x0083, 0x0084, 0x0085, 0x0086, 0x0087, 0x0088, 0x0089,
     0x008A, 0x008B, 0x008C, 0x008D, 0x008E, 0x0095}
)  # fmt: skip
"""Message types 0x001A to 0x0095 that carry a broadcast ephemeris of any system."""


def _observations(records: SbpRecords, *, base: bool) -> int:
    """Observation messages of the base (sender 0) or of the rover (any other sender)."""
    of_type = {sender: n for (kind, sender), n in records.counts.items() if kind == _OBSERVATIONS}
    return of_type.get(0, 0) if base else sum(of_type.values()) - of_type.get(0, 0)


# ---------------------------------------------------------------- inputs


Kind = Literal["SBP", "UBX", "observation", "navigation"]

EPHEMERIS_AGE_S: Final = {
    "GPS": 7201.0,
    "GLO": 1800.0,
    "GAL": 14400.0,
    "QZS": 7201.0,
    "BDS": 21601.0,
    "SBS": 360.0,
}
"""Largest distance from the reference time at which RTKLIB uses an ephemeris (rtklib.h, MAXDTOE)."""

_TIME_SYSTEMS: Final = ("GPS", "GAL", "QZS", "IRN", "GLO")
"""Time systems of observations that RTKLIB knows, or that agree with that of GPS (rinex.c, readrnxobs)."""

_CURE_ROVER: Final = "Give the rover's SBP or UBX log or RINEX observation files"
_CURE_BASE: Final = "Give base=None for the corrections inside an SBP log, or the files of the base station"


@dataclass(slots=True)
class PpkInputs:
    """Prepared files: scans of what they hold, and SBP logs by role."""

    rover: list[RinexScan] = field(default_factory=list)
    base: list[RinexScan] = field(default_factory=list)
    nav: list[RinexScan] = field(default_factory=list)
    sbp: dict[str, SbpRecords] = field(default_factory=dict)
    losses: Counter[str] = field(default_factory=Counter)
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
    """Whether a file is an SBP or UBX log, RINEX observations or RINEX navigation data.

    Raises
    ------
    InputError : it is missing, empty or none of them.
    """
    require_file(path, "an SBP log or a RINEX file")
    with path.open("rb") as stream:
        head = stream.read(65536)
    if b"RINEX VERSION" not in head[:100]:
        if find_messages(np.frombuffer(head, np.uint8)).kind.size > 1:
            return "SBP"
        if ubx_share(head, path.stat().st_size):
            return "UBX"
    try:
        return rinex_kind(path, head)
    except InputError as error:
        if "first line" not in error.found:
            raise
        raise InputError(
            "neither an SBP or UBX log nor a RINEX file",
            expected="SBP frames (0x55 ... CRC), UBX frames (0xB5 0x62 ...) or a line 'RINEX VERSION / TYPE'",
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
    rover_kind, base_kind = check_inputs(rover, base, nav)
    out = PpkInputs()
    tasks: list[dict[str, Any]] = []
    for role, files, kind in (("rover", rover, rover_kind), ("base", base or (), base_kind)):
        if kind == "SBP":
            records = out.sbp[role] = _join_sbp(files, folder / f"{role}.sbp", role, out)
            # the log of a receiver that only heard the base
            relayed = role == "base" and not _observations(records, base=False)
            _need_observations(records, files[0], base=relayed)
            tasks.append(_conversion(folder, role, "CONVBASE,BASEPOS" if relayed else ""))
        elif kind == "UBX":
            tasks.append(_join_ubx(files, folder, role, out))
        else:
            _copy_rinex(files, folder, role, "obs", out)
    if base is None:
        _need_observations(out.sbp["rover"], rover[0], base=True)
        tasks.append(_conversion(folder, "base", "CONVBASE,BASEPOS", source="rover"))
    _copy_rinex(nav, folder, "nav", "nav", out)
    if tasks:
        run_worker(tasks, folder, where=str(rover[0]), time_limit_s=time_limit_s)

    where_base = rover[0] if base is None else base[0]
    out.rover = _scan_all(folder, "rover", rover[0], out.notes)
    out.base = _scan_all(folder, "base", where_base, out.notes)
    nav_files = sorted(folder.glob("nav_*.nav"))
    nav_files += [p for p in sorted(folder.glob("*_log.nav")) if p.stat().st_size]
    out.nav = [scan for scan in map(scan_rinex, nav_files) if scan.t_gps_s.size]
    if not out.nav:
        found = "the navigation files hold no ephemeris" if nav else "no navigation file is given"
        if tasks and not nav:
            counts = [item for records in out.sbp.values() for item in records.counts.items()]
            heard = sum(n for (kind, _), n in counts if kind in EPHEMERIDES)
            found += f", and {heard} ephemeris messages of the SBP log gave none"
        raise InputError(
            found,
            expected="broadcast ephemerides of the session",
            where=nav[0] if nav else rover[0],
            cure="Give the RINEX navigation file of the receiver or of a network (BRDC) for that day",
        )
    return out


def check_inputs(
    rover: Sequence[Path], base: Sequence[Path] | None, nav: Sequence[Path]
) -> tuple[Kind, Kind | None]:
    """Kinds of the rover's and of the base's files, None without any.

    Raises
    ------
    InputError : a file is missing, of the wrong kind, or given twice; a RINEX rover without a base.
    """
    rover_kind = _role_kind(rover, "rover", ("SBP", "UBX", "observation"), _CURE_ROVER)
    base_kind = None if base is None else _role_kind(base, "base", ("SBP", "UBX", "observation"), _CURE_BASE)
    if base is None and rover_kind != "SBP":
        raise InputError(
            "no base files, and only an SBP rover holds observations of its base",
            expected="the observation files of a base station",
            where=rover[0],
            cure=_CURE_BASE,
        )
    if nav:
        _role_kind(nav, "navigation", ("navigation",), "Give RINEX navigation files (*.nav, *.yyN, *.yyP)")
    _refuse_doubles(rover, base or (), nav)
    return rover_kind, base_kind


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
            name = kind if kind in ("SBP", "UBX") else f"RINEX {kind} data"
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


def _join_sbp(files: Sequence[Path], target: Path, role: str, out: PpkInputs) -> SbpRecords:
    target.write_bytes(b"".join(Path(file).read_bytes() for file in files))
    records, n_bytes = collect([target]), target.stat().st_size
    out.bytes_read += n_bytes
    if lost := int(records.tally.cells[SKIPPED]):
        out.losses[f"{role} SBP bytes outside of intact frames"] = lost
        out.notes.append(
            f"{role}: {lost:,} of {n_bytes:,} SBP bytes belong to no intact frame (cut or damaged log)."
        )
    return records


def _need_observations(records: SbpRecords, file: Path, *, base: bool) -> None:
    if _observations(records, base=base):
        return
    kinds = {kind for kind, _ in records.counts}
    old = [name for kind, name in OLD_OBSERVATIONS.items() if kind in kinds]
    who = "base observations (MsgObs of sender 0)" if base else "rover observations (MsgObs)"
    raise InputError(
        f"no {who} among {records.counts.total()} messages" + (f"; it holds {', '.join(old)}" if old else ""),
        expected="MsgObs (0x004A), the raw observations",
        where=file,
        cure="Give the files of a base station"
        if base
        else "Enable raw observations in the receiver's logging",
    )


def _join_ubx(files: Sequence[Path], folder: Path, role: str, out: PpkInputs) -> dict[str, Any]:
    report = IntegrityReport.of(role, "UBX", ())
    n = sum(name in RAW_OBSERVATIONS for file in files for name, _ in ubx_frames(Path(file), report))
    out.bytes_read += report.bytes_read
    if lost := report.losses.get("bytes_outside_messages", 0):
        out.losses[f"{role} UBX bytes outside of intact messages"] = lost
        out.notes.append(f"{role}: {lost:,} of {report.bytes_read:,} UBX bytes belong to no intact message.")
    if not n:
        raise InputError(
            "no raw observations in a UBX log",
            expected="messages RXM-RAWX (and RXM-SFRBX for ephemerides)",
            where=files[0],
            cure="Enable UBX-RXM-RAWX and UBX-RXM-SFRBX in the receiver, or give RINEX observation files",
        )
    source = folder / f"{role}.ubx"
    source.write_bytes(b"".join(Path(file).read_bytes() for file in files))
    return _conversion(folder, role, "") | {"format": "UBX", "source": str(source)}


def _conversion(folder: Path, role: str, receiver_options: str, source: str = "") -> dict[str, Any]:
    return {
        "action": "convert",
        "format": "SBP",
        "source": str(folder / f"{source or role}.sbp"),
        "obs": str(folder / f"{role}_000.obs"),
        # Ephemerides come from the receiver that decoded them; those among the corrections are put aside.
        "nav": str(folder / (f"{role}.ignored" if source else f"{role}_log.nav")),
        "receiver_options": receiver_options,
    }


def _copy_rinex(files: Sequence[Path], folder: Path, role: str, suffix: str, out: PpkInputs) -> None:
    for index, file in enumerate(files):
        scan = scan_rinex(Path(file))
        if scan.kind == "observation" and scan.time_system not in _TIME_SYSTEMS:
            raise InputError(
                f"epochs of the {role} in the time system {scan.time_system}",
                expected=f"one of {', '.join(_TIME_SYSTEMS)}: RTKLIB takes any other for GPS time",
                where=file,
                cure="Export it in GPS time",
            )
        data = Path(file).read_bytes()
        out.bytes_read += len(data)
        for what, n in scan.losses.items():
            out.losses[f"{role} {what}"] += n
        if scan.losses:
            text = losses_in_words(scan)
            out.notes.append(f"{role}: damaged or cut records were left out of {Path(file).name}: {text}.")
        (folder / f"{role}_{index:03d}.{suffix}").write_bytes(whole_records(scan, data))


def _scan_all(folder: Path, role: str, where: Path, notes: Sequence[str]) -> list[RinexScan]:
    scans = [scan_rinex(path) for path in sorted(folder.glob(f"{role}_*.obs")) if path.stat().st_size]
    if not sum(scan.t_gps_s.size for scan in scans):
        damage = [note for note in notes if note.startswith(f"{role}: damaged or cut")]
        raise InputError(
            "; ".join([f"no epoch with observations of the {role}", *(note.rstrip(".") for note in damage)]),
            expected="at least one epoch",
            where=where,
            cure="Look at the line that is named and export the file again"
            if damage
            else "The file is cut or was logged without satellites",
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
    letter = next(key for key, name in SYSTEM_OF_LETTER.items() if name == system)
    codes = [code for scan in scans for code in scan.codes.get(letter, next(iter(scan.codes.values()), []))]
    return {code[:2] for code in codes if code.startswith("L")}


def _span(t: ArrayF) -> str:
    return f"{utc_text_from_gps(float(t[0]), 0)} .. {utc_text_from_gps(float(t[-1]), 0)}"


def _nav_spans(nav: list[RinexScan]) -> str:
    systems = sorted({s for scan in nav for s in scan.nav_t_gps_s})
    times = {s: np.concatenate([scan.nav_t_gps_s.get(s, np.zeros(0)) for scan in nav]) for s in systems}
    return "; ".join(f"{s} {_span(np.sort(t))}" for s, t in times.items())


def _list(names: set[str]) -> str:
    return ", ".join(sorted(names)) or "none"


# ---------------------------------------------------------------- solution


_BASE_MOVES_M: Final = 15.0
"""Single-point positions of two frequencies scatter by a few metres."""
_QUICK_S: Final = 60.0
_BASE_LIMIT_M = (
    1000.0  # a single-point position is good to 10 m: more than 1 km is another place or a typing error
)
_BASE_DOUBT_M = 30.0  # three times the 95 % error of a single-point position
_HEADER_DELTA_M = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class PpkSolution:
    """Positions of kind `GNSS_POSITION`, the report, the options, and the base position used, shape (3,)."""

    positions: pd.DataFrame
    report: IntegrityReport
    options: PpkOptions
    base_ecef_m: ArrayF

    @property
    def fixed(self) -> pd.DataFrame:
        """The positions with fixed ambiguities only."""
        return self.positions[self.positions["fix"] == "fixed"].reset_index(drop=True)

    @property
    def fix_ratio(self) -> float:
        """Share of all rover epochs, those without solution included, that have a fixed position."""
        return float(self.report.details["fix_ratio"])


def run_ppk(
    rover: Sequence[Path],
    base: Sequence[Path] | None,
    nav: Sequence[Path],
    options: PpkOptions,
    *,
    time_limit_s: float = 900.0,
) -> PpkSolution:
    """Positions of a rover relative to a base.

    Parameters
    ----------
    rover : SBP logs (joined in this order) or RINEX observation files of the rover.
    base : the same of the base; None takes the corrections (sender 0) inside the rover's SBP log.
    nav : RINEX navigation files; may be empty if an SBP log holds ephemerides.
    options : see `PpkOptions`.
    time_limit_s : each run of the engine is stopped after that.

    Returns
    -------
    PpkSolution; ``report.details`` holds fix_ratio (of all rover epochs), n_fixed, n_float, n_single,
    n_other, n_none, n_rover_epochs, n_fixes_refused (by reason), fixed_sigma_factor, float_sigma_factors (of
    the first and the last epoch), baseline_m (median) and baseline_max_m, base_ecef_m, base_check_m (distance
    to the base's own single-point position), n_covariances_replaced, engine and options.

    Raises
    ------
    InputError : inputs are missing, of the wrong kind, do not overlap, hold no ephemerides or no base
        position; or the engine crashed, ran too long, or found no solution.
    ConfigError : the engine did not take an option.
    """
    with tempfile.TemporaryDirectory(prefix="thalweg-ppk-") as name:
        folder = Path(name)
        inputs = prepare_inputs(rover, base, nav, folder, time_limit_s=time_limit_s)
        rover_file, base_file = Path(rover[0]), Path(rover[0] if base is None else base[0])
        if options.systems == "auto":
            options = replace(options, systems=_common_systems(inputs))
        notes = preflight(inputs, options, rover_file, base_file)
        base_ecef_m, base_notes = _base_position(inputs, options, base_file)
        where = f"{rover_file}, {base_file}"
        solve = partial(
            _solve, folder, inputs, base_ecef_m=base_ecef_m, where=where, time_limit_s=time_limit_s
        )
        base_check_m, check_notes = _check_base(solve(options, single=True).positions, base_ecef_m, base_file)
        run = solve(options, single=False)
        positions, floats = run.positions, run
        if (positions["fix"] == "fixed").any():
            floats = solve(replace(options, ambiguity="off"), single=False)
    if positions.empty:
        raise InputError(
            f"the RTKLIB engine found no position for {inputs.rover_t_gps_s.size} rover epochs; it printed: "
            f"{run.answer.output}",
            expected="at least one position",
            where=where,
            cure="; ".join(notes + base_notes + check_notes)
            or "Check systems and frequencies of both receivers",
        )
    positions, n_replaced = replace_covariances(positions)
    positions, trust = trust_fixes(
        positions,
        replace_covariances(floats.positions)[0],
        phase_factor(run.residuals),
        code_factors(floats.residuals),
        np.linalg.norm(_places(positions) - base_ecef_m, axis=1),
        positions["h_ell_m"].to_numpy() - geodetic_of(base_ecef_m)[2],
        trusted_baseline_km=options.trusted_baseline_km,
        least_fix_s=options.least_fix_s,
        direction=options.direction,
    )
    files = [str(file) for file in [*rover, *(base or []), *nav]]
    report = _report(positions, inputs, options, base_ecef_m, run.answer, files)
    report.details |= {"base_check_m": base_check_m, "n_covariances_replaced": n_replaced, **trust.report()}
    if n_replaced:
        report.note(
            f"{n_replaced} covariances of the engine were indefinite or below 0.5 mm (lost digits) and are "
            "replaced by the median of their neighbours"
            + ("." if options.dynamics else "; with dynamics=True the engine keeps its digits.")
        )
    for sentence in trust.notes() + inputs.notes + check_notes + base_notes + notes:
        report.note(sentence)
    return PpkSolution(positions=positions, report=report, options=options, base_ecef_m=base_ecef_m)


def _common_systems(inputs: PpkInputs) -> tuple[str, ...]:
    """Of `AUTO_SYSTEMS` those of rover, base and ephemerides; all where there are none, for the message."""
    have = [{s for scan in scans for s in scan.systems} for scans in (inputs.rover, inputs.base)]
    have.append({s for scan in inputs.nav for s in scan.nav_t_gps_s})
    return tuple(s for s in AUTO_SYSTEMS if all(s in each for each in have)) or AUTO_SYSTEMS


def base_extent_m(rover: Sequence[Path], base: Sequence[Path], nav: Sequence[Path]) -> float:
    """How far single-point positions of the base lie from their middle, median, metres.

    Some metres of noise for a station that stands; a receiver on a boat or a car is told by that.

    Raises
    ------
    InputError : of `run_ppk`, or there is no position.
    """
    with tempfile.TemporaryDirectory(prefix="thalweg-ppk-") as name:
        folder = Path(name)
        inputs = prepare_inputs(rover, base, nav, folder, time_limit_s=_QUICK_S)
        options = PpkOptions(base_source="rinex_header", systems=_common_systems(inputs))
        single = _solve(
            folder,
            inputs,
            options,
            base_ecef_m=np.array([6_378_137.0, 0.0, 0.0]),  # any: no double differences are formed
            where=str(base[0]),
            time_limit_s=_QUICK_S,
            single=True,
        ).positions
    if single.empty:
        raise InputError("no single-point position", expected="observations and ephemerides", where=base[0])
    return float(np.median(_from_middle_m(_places(single))))


def _places(positions: pd.DataFrame) -> ArrayF:
    """Earth-centred places (n, 3) of positions, metres."""
    return ecef_of(*(positions[c].to_numpy() for c in ("lat_deg", "lon_deg", "h_ell_m")))


def _from_middle_m(xyz: ArrayF) -> ArrayF:
    """Distances (n,) from the median place."""
    return np.asarray(np.linalg.norm(xyz - np.median(xyz, axis=0), axis=1))


def _base_position(inputs: PpkInputs, options: PpkOptions, base_file: Path) -> tuple[ArrayF, list[str]]:
    """Position of the base's antenna reference point in earth-centred metres, and notes."""
    notes: list[str] = []
    scan = inputs.base[0]
    height, east, north = scan.antenna_delta_hen_m
    header_delta = np.array([east, north, height])
    delta = np.asarray(options.base_antenna_delta_enu_m, dtype=np.float64)
    position = options.explicit_base_ecef_m
    if options.base_source == "from_sbp":
        position = _sbp_base(inputs, base_file, notes)
    elif options.base_source == "rinex_header":
        position = scan.approx_ecef_m
        fault = "is absent" if position is None else ecef_fault(position)
        if position is None or fault:
            raise InputError(
                f"the APPROX POSITION XYZ of the base {fault}",
                expected="earth-centred coordinates of the base",
                where=base_file,
                cure="Give base_ecef_m or base_llh from the survey of the base",
            )
        notes.append(
            "The base position is the approximate position of a RINEX header: it may be metres off, and "
            "every position is off with it."
        )
        delta = delta + header_delta
    elif np.linalg.norm(header_delta - delta) > _HEADER_DELTA_M and np.any(header_delta):
        notes.append(
            f"The base header states an antenna offset of {east:.4f}, {north:.4f}, {height:.4f} m (east, "
            f"north, up); used is {delta[0]:.4f}, {delta[1]:.4f}, {delta[2]:.4f} m."
        )
    assert position is not None
    if np.any(delta):
        lat, lon, _ = geodetic_of(position)
        position = position + rotation_ecef_enu(lat, lon) @ delta
    return np.asarray(position, dtype=np.float64), notes


def _sbp_base(inputs: PpkInputs, base_file: Path, notes: list[str]) -> ArrayF:
    stated = np.concatenate([np.empty((0, 3)), *map(base_positions, inputs.sbp.values())])
    valid = stated[[not ecef_fault(row) for row in stated]] if stated.size else stated
    if not valid.size:
        raise InputError(
            "no valid position of the base (MsgBasePosECEF, MsgBasePosLLH) in the SBP logs",
            expected="the surveyed position of the base in the log",
            where=base_file,
            cure="Give base_ecef_m or base_llh from the survey of the base",
        )
    position = np.median(valid, axis=0)
    spread = float(np.max(np.linalg.norm(valid - position, axis=1)))
    if spread > 0.01:
        notes.append(
            f"The base positions stated in the SBP log differ by up to {spread:.3f} m; their median is used."
        )
    return np.asarray(position)


@dataclass(frozen=True, slots=True)
class _Run:
    """What a run of the engine gave: positions, residuals (`read_residuals`), and what it printed."""

    positions: pd.DataFrame
    residuals: pd.DataFrame
    answer: EngineAnswer


def _solve(
    folder: Path,
    inputs: PpkInputs,
    options: PpkOptions,
    *,
    base_ecef_m: ArrayF,
    where: str,
    time_limit_s: float,
    single: bool,
) -> _Run:
    """One run of the engine: PPK of the rover, or single-point positions of the base every 30 s."""
    name = "single" if single else "ppk"
    config, readback, output = (folder / f"{name}.{end}" for end in ("conf", "taken", "pos"))
    settings = engine_settings(options, base_ecef_m, single=single)
    write_settings(config, settings)
    task = {
        "action": "solve",
        "config": str(config),
        "readback": str(readback),
        "inputs": [
            *(str(folder / f"{role}_*.obs") for role in (("base",) if single else ("rover", "base"))),
            *(str(scan.path) for scan in inputs.nav),
        ],
        "output": str(output),
        "interval_s": 30.0 if single else 0.0,
    }
    answer = run_worker([task], folder, where=where, time_limit_s=time_limit_s)
    check_settings(readback, settings)
    residuals = read_residuals(folder / f"{output.name}.stat")
    # a filter that runs backward writes its last epoch first
    return _Run(
        read_solution(output).sort_values("t_gps_s", kind="stable", ignore_index=True), residuals, answer
    )


def _check_base(single: pd.DataFrame, base_ecef_m: ArrayF, base_file: Path) -> tuple[float | None, list[str]]:
    """Distance of the base position from its own single-point position; refuses another place."""
    if single.empty:
        return None, [
            "The base position could not be checked: its observations give no single-point position."
        ]
    xyz = _places(single)
    if (moved := float(np.median(_from_middle_m(xyz)))) > _BASE_MOVES_M:
        raise InputError(
            f"the base moved: its single-point positions lie {moved:.0f} m from their middle, median",
            expected="a base that stands",
            where=base_file,
            cure="Are the files of rover and base exchanged?",
        )
    distance = float(np.linalg.norm(np.median(xyz, axis=0) - base_ecef_m))
    if distance > _BASE_LIMIT_M:
        raise InputError(
            f"the base position lies {distance / 1000.0:.1f} km from where its own observations put it",
            expected=f"less than {_BASE_LIMIT_M / 1000.0:g} km",
            where=base_file,
            cure="Check order, sign and unit of the base coordinates and that the file is of this base",
        )
    if distance > _BASE_DOUBT_M:
        return distance, [
            f"The base position lies {distance:.0f} m from the base's own single-point position: check it."
        ]
    return distance, []


def _report(
    positions: pd.DataFrame,
    inputs: PpkInputs,
    options: PpkOptions,
    base_ecef_m: ArrayF,
    answer: EngineAnswer,
    files: list[str],
) -> IntegrityReport:
    n_rover = inputs.rover_t_gps_s.size
    by_fix = positions["fix"].value_counts().to_dict()
    n = {name: int(by_fix.get(name, 0)) for name in ("fixed", "float", "single")}
    n_none = max(0, n_rover - len(positions))
    report = IntegrityReport(
        stream="PPK positions",
        format="SBP" if "rover" in inputs.sbp else f"RINEX {inputs.rover[0].version}",
        files=files,
        model=inputs.rover[0].text("REC # / TYPE / VERS", 20, 40),
        time_scale="gps",
        synchronised=True,
        bytes_read=inputs.bytes_read,
        counts={
            "rover epochs": n_rover,
            "base epochs": inputs.base_t_gps_s.size,
            "ephemerides": sum(scan.t_gps_s.size for scan in inputs.nav),
            "positions": len(positions),
        },
        losses=dict(inputs.losses),
    )
    report.take_times(positions["t_gps_s"], "positions")
    report.lose("rover epochs without solution", n_none)
    baseline = np.linalg.norm(_places(positions) - base_ecef_m, axis=1)
    report.details = {
        "fix_ratio": n["fixed"] / n_rover,
        "n_rover_epochs": n_rover,
        **{f"n_{name}": count for name, count in n.items()},
        "n_other": len(positions) - sum(n.values()),
        "n_none": n_none,
        "baseline_m": float(np.median(baseline)),
        "baseline_max_m": float(np.max(baseline)),
        "base_ecef_m": [float(x) for x in base_ecef_m],
        "engine": f"{engine_version()} ({answer.engine})",
        "options": options.plain(),
    }
    if not n["fixed"]:
        report.note("No position is fixed: the ambiguities stayed float; expect decimetres, not centimetres.")
    if options.ambiguity == "instantaneous":
        report.note("Ambiguity 'instantaneous' fixes next to nothing in this engine: use 'continuous'.")
    if options.direction == "combined":
        report.note(
            "Direction 'combined' weights two filters over the same observations as if they were "
            "independent: the stated sigmas are up to 1.4 times too small."
        )
    if n["single"]:
        report.note(f"{n['single']} positions are single-point: metres, without the base.")
    return report
