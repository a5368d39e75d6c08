"""The command ``thalweg check-config``, which also opens logs: refusals of the first jobs, before they run.

The functions are those that the jobs call, so that both never disagree. Raw GNSS is not processed for that,
and logs of more than `LARGEST_BYTES` are not opened.
"""

import argparse
import datetime as dt
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from thalweg.commands.options import CAMPAIGNS
from thalweg.commands.parser import Commands
from thalweg.core import ConfigError, InputError, ThalwegError

if TYPE_CHECKING:
    import pandas as pd

    from thalweg.ingest import IntegrityReport
    from thalweg.settings import Campaign
    from thalweg.workflow import CampaignFiles

LARGEST_BYTES: Final = 300_000_000
"""Reading more takes longer than a person waits for a check."""
_LONG_DAYS: Final = 30
"""Logs of one stream that are farther apart are hardly of one survey."""


class FirstJobs:
    """The first jobs of a survey, without their outputs.

    Attributes
    ----------
    errors : refusals, in the order of the jobs.
    skipped : streams that were not opened, and why.
    notes : what no job refuses, and a person should look at.
    """

    def __init__(self, files: "CampaignFiles") -> None:
        self.errors: list[ThalwegError] = []
        self.skipped: list[str] = []
        self.notes: list[str] = []
        self._files = files
        self._reports: list[IntegrityReport] = []
        if files.campaign.kind == "survey":
            self._survey()
        elif files.campaign.kind == "photographs" and not files.logs("finished_orientations"):
            self._tried(self._photographs)

    def _survey(self) -> None:
        from thalweg.clocks import common_span

        files = self._files
        self._opened("lidar", files.logs("lidar"), self._lidar)
        states = self._opened("ins", files.ins_logs(), self._states)
        images = files.campaign.images
        if states is not None and files.logs("time_lapse") and images.cloud.motion == "velocity":
            from thalweg.navigation.camera import states_with_velocity

            self._tried(lambda: states_with_velocity(states))
        source = files.position_source()
        if source in ("ins", "sbet"):
            positions = [] if states is None else files.ins_logs()
            self._opened(
                "positions", positions, lambda paths: self._as_stream("positions", self._reports[-1])
            )
        elif source != "ppk":
            self._opened("positions", files.position_logs(), self._positions)
        else:
            self._tried(self._raw_gnss)
        self._opened("depth", files.logs("depth"), self._depth)
        if self.errors or self.skipped:
            return  # what is missing here is no stream without overlap
        needed = ("lidar", "ins", "positions") if files.ins_logs() else ("depth", "positions")
        chosen = [report.stream for report in self._reports if report.stream in needed]
        if source == "ppk":
            return  # whose positions no job has computed yet
        self._tried(lambda: common_span(self._reports, needed=chosen))
        if states is not None and source in ("ins", "sbet"):
            self._tried(lambda: self._trajectory(states))

    def _photographs(self) -> None:
        from thalweg.images import what_is_given

        logs = {
            name: [Path(log) for log in self._files.logs(name)]
            for name in ("time_lapse", "control_points", "image_marks", "camera_positions")
        }
        marks, positions = (next(iter(logs[name]), None) for name in ("image_marks", "camera_positions"))
        campaign = self._files.campaign
        control = campaign.images.control
        what_is_given(
            logs["time_lapse"], campaign.campaign.crs, logs["control_points"], marks, positions, control
        )

    def _opened(self, stream: str, logs: list[str], read: "Callable[[list[Path]], Any]") -> Any:
        paths = [Path(log) for log in logs]
        size = sum(path.stat().st_size for path in paths)
        if size > LARGEST_BYTES:
            self.skipped.append(f"{stream} ({size / 1e9:.1f} GB, too large for a check)")
        elif paths:
            return self._tried(lambda: read(paths))
        return None

    def _tried(self, step: "Callable[[], Any]") -> Any:
        try:
            return step()
        except ThalwegError as error:
            self.errors.append(error)
        return None

    def _as_stream(self, stream: str, report: "IntegrityReport") -> None:
        from dataclasses import replace

        self._reports.append(replace(report, stream=stream))
        first, last = report.t_first_s, report.t_last_s
        if report.synchronised and first is not None and last is not None:
            days = (last - first) / 86_400.0
            if days > _LONG_DAYS and len(report.files) > 1:
                self.notes.append(
                    f"the logs of stream '{stream}' are {days:.0f} days apart; keep those of one survey"
                )

    def _lidar(self, paths: list[Path]) -> None:
        from thalweg.ingest import LidarOptions
        from thalweg.ingest.registry import lidar_reader
        from thalweg.lidar import with_stated_clock

        reader = lidar_reader(paths, LidarOptions(**self._files.lidar_options()))
        scan, stated = reader.scan(), self._files.campaign.lidar.clock
        if stated.source == "motion" and not scan.report.synchronised:
            self.skipped.append("the time of the lidar (its motion beside the trajectory tells it)")
            return
        _, report = with_stated_clock(reader, scan, stated)
        self._as_stream("lidar", report)

    def _states(self, paths: list[Path]) -> "pd.DataFrame":
        from thalweg.core import LocalFrame
        from thalweg.ingest import TrackOptions
        from thalweg.ingest.registry import read_poses

        files = self._files
        options = TrackOptions(
            **files.track_options(),
            smrmsg=tuple(Path(p) for p in files.smrmsg_logs()),
            frame=LocalFrame(**files.section("campaign", "origin")),
        )
        log = read_poses(paths, "sbet" if files.position_source() == "sbet" else "ins", options)
        self._as_stream("ins", log.report)
        return log.states

    def _positions(self, paths: list[Path]) -> None:
        from thalweg.ingest.registry import read_positions
        from thalweg.navigation.ins_gnss import TrajectorySummary, usable_positions, with_stated

        source, none = self._files.position_source(), list[Path]()
        table, report = read_positions(
            source,
            paths,
            states=None,
            date=self._date(),
            topics=self._files.topics("pos"),
            base=none,
            nav=none,
            ppk={},
            base_position={},
        )
        self._as_stream("positions", report)
        stated = with_stated(table, **self._files.stated_positions())
        accepted, gap_s = (self._files.section("orientation", key) for key in ("accept_fixes", "max_gap_s"))
        if report.synchronised:
            usable_positions(stated, accepted, TrajectorySummary(), gap_s)

    def _raw_gnss(self) -> None:
        from thalweg.ingest.ppk import check_inputs

        rover, base, nav = (
            [Path(log) for log in logs]
            for logs in (
                self._files.position_logs(),
                self._files.ppk_logs("base"),
                self._files.ppk_logs("nav"),
            )
        )
        check_inputs(rover, base or None, nav)

    def _depth(self, paths: list[Path]) -> None:
        from thalweg.ingest.registry import read_depths

        self._as_stream("depth", read_depths(paths, self._date(), self._files.topics("depth")).report)

    def _date(self) -> dt.date | None:
        date = self._files.log_option("depth_date")
        return dt.date.fromisoformat(date) if date else None

    def _trajectory(self, states: "pd.DataFrame") -> None:
        import numpy as np

        from thalweg.core import LocalFrame
        from thalweg.navigation.ins_gnss import trajectory_from_states

        ins = self._files.section("ins")
        trajectory_from_states(
            states,
            LocalFrame(**self._files.section("campaign", "origin")),
            max_attitude_gap_s=self._files.section("orientation", "max_attitude_gap_s"),
            sigma_attitude_rad=np.deg2rad([ins[f"sigma_{a}_deg"] for a in ("roll", "pitch", "heading")]),
            sigma_position_m=ins["sigma_position_m"],
        )


def add_check_command(commands: Commands) -> None:
    """Add ``check-config``."""
    commands.add(
        "check-config",
        "check campaign files; report all mistakes at once",
        _check_config,
        ("files", [str], "FILE", "campaign file, or id of one"),
    )


def _check_config(options: argparse.Namespace) -> int:
    from thalweg.settings import load_campaigns
    from thalweg.settings.sections import STREAM_KEYS
    from thalweg.workflow import CampaignFiles

    for name, campaign in load_campaigns(options.files, CAMPAIGNS).items():
        for path in [path for stream in STREAM_KEYS for path in campaign.log_files(stream)]:
            if path.is_symlink() and not path.resolve().is_relative_to(path.parent.resolve()):
                print(f"note: {path} is a link out of its folder, to {path.resolve()}", file=sys.stderr)
        _check_contents(campaign)
        _check_epochs(campaign)
        files = CampaignFiles(name=name, campaigns={name: campaign})
        jobs = FirstJobs(files) if campaign.logs else None
        if jobs and jobs.errors:
            raise ConfigError(
                "what the first jobs would refuse:\n"
                + "\n".join(f"  {each}" for each in jobs.errors).rstrip("."),
                where=name,
            )
        counts = {stream: len(campaign.log_files(stream)) for stream in STREAM_KEYS}
        named = ", ".join(f"{n} {stream}" for stream, n in counts.items() if n)
        source = f"files: {named}" if campaign.logs else "digital twin"
        identity = campaign.campaign
        if campaign.is_change:
            epochs = ", ".join(campaign.epoch_names)
            print(f"{name}: ok. {identity.title}; {identity.crs}; epochs {epochs}")
            continue
        if campaign.logs and campaign.logs.kind != "boat":
            print(f"{name}: ok. {identity.title}; {identity.crs}; {source}")
        else:
            print(
                f"{name}: ok. {identity.title}; {identity.crs}; "
                f"positions from {campaign.orientation.position_source}; {source}"
            )
            print(f"  places of the sensors: {_places(campaign)}")
        if jobs and jobs.skipped:
            print(f"  not checked: {', '.join(jobs.skipped)}")
        for note in jobs.notes if jobs else ():
            print(f"note: {note}", file=sys.stderr)
        products = files.products() if campaign.logs else []
        for made, words in ((True, "gives"), (False, "more logs would add")):
            listed = [f"{p.name}{'' if made else f' ({p.needs})'}" for p in products if p.made is made]
            if listed:
                print(f"  {words}: {', '.join(listed)}")
    return 0


def _places(campaign: "Campaign") -> str:
    """Where the place of each sensor comes from, in words."""
    from thalweg.settings import mount_sources

    by_source: dict[str, list[str]] = {}
    for sensor, source in mount_sources(campaign).items():
        by_source.setdefault(source, []).append(sensor)
    parts = [
        f"{', '.join(sensors)} {f'from {source}' if source else 'not stated, values by default'}"
        for source, sensors in by_source.items()
    ]
    return "; ".join(parts)


def _check_contents(campaign: "Campaign") -> None:
    """Are the logs what the campaign file takes them for? All misplaced files are named at once."""
    from thalweg.ingest.registry import KINDS, KINDS_OF_STREAM, recognise
    from thalweg.settings.sections import STREAM_KEYS

    wrong = []
    for stream, keys in STREAM_KEYS.items():
        # tables that people write, and pictures, have no mark of their own
        for path in campaign.log_files(stream) if stream in KINDS_OF_STREAM else []:
            try:
                kind = recognise(path)
            except InputError as error:
                if KINDS_OF_STREAM[stream]:  # else a kind that has no mark of its own
                    wrong.append(f"  logs.{'.'.join(keys)}: {error}")
                continue
            fitting = KINDS_OF_STREAM["cloud" if campaign.kind == "cloud" else stream]
            source = campaign.orientation.position_source
            if stream == "pos":
                fitting = (source,) if source in ("nmea", "gpx") else fitting
            if fitting and kind not in fitting:
                expected = " or ".join(KINDS[name] for name in fitting)
                wrong.append(f"  logs.{'.'.join(keys)}: {path} holds a {KINDS[kind]}; expected: {expected}.")
    if wrong:
        raise ConfigError(
            "files that are not what they are named for:\n" + "\n".join(wrong),
            where=campaign.id,
            cure="Name each file under its own key; `thalweg describe FILE` says what a file is",
        )


def _check_epochs(campaign: "Campaign") -> None:
    """Do files of epochs hold what the campaign file says? All mistakes are named at once."""
    if not any(epoch.of_files for epoch in campaign.epochs or []):
        return
    from thalweg.core import LocalFrame
    from thalweg.deformation.foreign import check_epoch_files, dsm_of, onto_grid, with_drawn_areas

    wrong = []
    assert campaign.campaign.origin is not None  # epochs have one
    frame = LocalFrame(**campaign.campaign.origin.model_dump())
    for number, epoch in enumerate(campaign.epochs or []):
        try:
            check_epoch_files(epoch, frame, campaign.campaign.crs)
        except ThalwegError as error:
            wrong.append(f"  epochs[{number}]: {error}")
    try:
        with_drawn_areas(campaign.deformation, frame, campaign.campaign.crs)
    except ThalwegError as error:
        wrong.append(f"  deformation.stable: {error}")
    for number, (before, after) in enumerate(pairwise(campaign.epochs or [])):
        if wrong or before.dsm is None or after.dsm is None:
            continue
        try:
            onto_grid(dsm_of(after), dsm_of(before), campaign.deformation.resample)
        except ThalwegError as error:
            wrong.append(f"  epochs[{number + 1}]: {error}")
    if wrong:
        told = "\n".join(wrong).rstrip(".")
        raise ConfigError(f"files of epochs that cannot be used:\n{told}", where=campaign.id)
