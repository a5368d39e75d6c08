"""What ``thalweg check-config`` finds out by opening logs: refusals of the first jobs, before they run.

The functions are those that the jobs call, so that both never disagree. Raw GNSS is not processed for that,
and logs of more than `LARGEST_BYTES` are not opened.
"""

import datetime as dt
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    import pandas as pd

    from thalweg.core import ThalwegError
    from thalweg.ingest import IntegrityReport
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
        from thalweg.core import ThalwegError

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
