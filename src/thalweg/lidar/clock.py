r"""Time of a lidar without GPS time: stated, by NMEA sentences without PPS, or by the motion of the boat.

Roughly: two sweeps, `PAIR_S` apart, show surfaces of the same places. Point-to-plane registration (Chen and
Medioni 1992) gives the rotation vector ``phi`` between both, in the scanner's frame. Of the trajectory

    phi_k = -R_scs_ics [Theta(t_k + dt/2) - Theta(t_k - dt/2)],    Theta(t) = sum of body rotations up to t

with ``t_k`` the device's time plus its offset. Every offset for which the trajectory covers the sweeps is
tried (correlation of angular rates). What a rotation stands for in time differs between its components: a
beam on the left bank fires when that on the right bank does not. Each component therefore has a time of its
own, the mean of its points' times weighted by what they contribute to it. Lines of few lasers hold on to each
other, so that a registration errs towards no motion: it tells which tenth of a second, and no more.

Then finely: with a wrong time a plane spot of the bank that was seen again (`thalweg.lidar.overlap`)
lies apart by what the boat moved differently both times. Offset, drift and the errors of the mount are
adjusted to the distances ``d`` from the planes, whose own three parameters are eliminated:

    d = (n . dx/dt) (offset + drift t) + (a x n) . e_rotation + n . e_shift + noise

Points of one moment err together, by their pose: standard deviations are those of a fit whose scores are
correlated over `CORRELATED_S` (Newey and West 1987, Econometrica 55), and what errors of the attitudes that
swing with the boat may add.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

import numpy as np
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from thalweg.core import ArrayB, ArrayF, ClockError, CoverageError, Rigid, Trajectory, gps_from_unix
from thalweg.ingest import IntegrityReport, LidarClock, LidarReader, LidarScan
from thalweg.lidar.filters import water_level_m
from thalweg.lidar.georeference import georeference_points
from thalweg.lidar.overlap import LEAST_PLANES, planes_seen_again, sums, windows_of
from thalweg.settings.sections import Filters, LidarClockStated

PAIR_S: Final = 0.3
"""From one sweep to the other: a boat turns by more than the registration errs, and still sees the same."""
STEP_S: Final = 0.1
CORRELATED_S: Final = 2.0
SEARCH_S: Final = 60.0
"""Offsets so far from a stated one are tried."""
SPAN_S: Final = 100.0
"""Of a long recording three stretches so long are registered: begin, middle, end."""
SIGMA_DRIFT: Final = 50e-6
"""Of a free-running crystal before anything is known."""
LEAST_SIGMAS: Final = 5.0
"""By so much the best offset must be better than any other that is not beside it."""
LEAST_PAIRS: Final = 50
_NEAR_M, _FAR_M = 2.0, 40.0
_VOXEL_M: Final = 0.3
"""Points are thinned to it: along a line of one laser they lie much denser than from line to line."""
_NEIGHBOURS: Final = 10
_REACH_M: Final = (1.0, 0.7, 0.5, 0.5, *(0.3,) * 10)
"""Longest distance of partners, by iteration."""
_FEWEST_POINTS: Final = 100
_BESIDE_S: Final = 0.6
_COARSE_S: Final = 0.05
_LARGEST_STEP_S: Final = 2e-4
"""A drifting clock is put into stretches whose offsets differ by so much."""
_MOST_POINTS: Final = 400_000
"""Of a window."""
_MOST_ROUNDS: Final = 30
_SMALL_STEP_S: Final = 3e-4
"""Planes are chosen anew in each round, which moves the result by as much."""
_SOONEST_S: Final = 0.05
"""By so much the soonest sentence of a minute varies: interval of position packets, jitter of receivers."""
_PLANES_OF_A_MOMENT: Final = 10.0
_LEAST_MOUNT: Final = 1e-6
_MOUNT: Final = [3, 4, 5, 0, 1, 2]
"""Rotation before shift: the order of the mount's unknowns in the rows of its covariance."""
_HALF_S: Final = 0.01
"""For derivatives: coarser than the distance of the poses."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Turns:
    """How the scanner turned from sweep to sweep.

    Attributes
    ----------
    phi_rad : (n, 3) rotation vector from the first sweep's frame to the second's, scs.
    info : (n, 3, 3) its weight, inverse covariance up to a common factor.
    first_s, second_s : (n, 3) mean device times of both sweeps, for each component.
    """

    phi_rad: ArrayF
    info: ArrayF
    first_s: ArrayF
    second_s: ArrayF


@dataclass(frozen=True, slots=True, kw_only=True)
class LidarOffset:
    """GPS time of a lidar's own clock.

    Attributes
    ----------
    clock : of the scan with GPS time, and with the largest standard deviation of it in the recording.
    offset_s : GPS minus device time at `reference_s` on the device's clock. drift : its change per second.
    sigma_offset_s, sigma_drift : their standard deviations.
    facts : numbers for a report.
    """

    clock: LidarClock
    offset_s: float
    drift: float
    reference_s: float
    sigma_offset_s: float
    sigma_drift: float
    facts: dict[str, Any]


def clock_by_hand(
    reader: LidarReader, clock: LidarClock, *, first_t_gps_s: float | None = None, offset_s: float = 0.0
) -> LidarClock:
    """A clock of the lidar that a person states, whole or in part.

    Parameters
    ----------
    reader : the log.
    clock : of its scan.
    first_t_gps_s : GPS time of the first packet of a lidar that had no GPS; stretches with GPS time of their
        own keep it.
    offset_s : added to the time of every packet.

    Raises
    ------
    ClockError : packets without GPS time, and no time is stated.
    """
    offsets = np.array(clock.gps_minus_device_s)
    unknown = np.isnan(offsets)
    if unknown.all() and first_t_gps_s is None:
        raise ClockError(
            "the lidar never had GPS time",
            expected="a capture with locked PPS and NMEA, or a time of its first packet",
            cure="Give the time of the first packet (--first-packet)",
        )
    if unknown.any() and first_t_gps_s is not None:
        first = next(iter(reader.points(clock, max_points=1000)))
        offsets[unknown] = first_t_gps_s - float(first.t_device_s[0])
    return replace(clock, gps_minus_device_s=tuple((offsets + offset_s).tolist()))


def with_stated_clock(
    reader: LidarReader,
    scan: LidarScan,
    stated: LidarClockStated,
    voyage: tuple[Trajectory, Rigid, Filters] | None = None,
) -> tuple[LidarClock, IntegrityReport]:
    """The clock of a scan with what is stated of its time or tells it, and the report that says so.

    Parameters
    ----------
    reader, scan : the log.
    stated : section ``lidar.clock``.
    voyage : trajectory, mount of the scanner and filters, for a clock that the motion tells.

    Raises
    ------
    ClockError : as of `clock_by_hand`, `clock_from_motion` and `clock_from_sentences`.
    """
    report, offset_s = scan.report, stated.offset_s
    unix_s = stated.first_packet_unix_s
    first = None if unix_s is None else float(gps_from_unix(unix_s))
    if stated.source != "stated" and not report.synchronised:
        return _estimated(reader, scan, stated, first, voyage)
    if stated.source != "stated":
        report.note(f"lidar.clock.source: {stated.source} is not used: the log has a time of its own")
    if first is None and offset_s == 0:
        return scan.clock, report
    if first is None and not report.synchronised:
        return scan.clock, report  # the offset of a clock that nobody knows; told where the streams meet
    clock = clock_by_hand(reader, scan.clock, first_t_gps_s=first, offset_s=offset_s)
    if report.synchronised:
        _shift(report, offset_s)
    else:
        words = f"its first packet is stated to be of {stated.first_packet_utc}"
        _tell(report, f"{words} (lidar.clock)", clock.gps_minus_device_s[0])
    if offset_s:
        report.note(f"All times of the lidar are shifted by {offset_s:+g} s (lidar.clock.offset_s)")
    return clock, report


def _tell(report: IntegrityReport, words: str, shift_s: float) -> None:
    """The report of a recording without GPS time, whose time is known all the same."""
    report.notes = [note for note in report.notes if not note.startswith("The lidar is unsynchronised")]
    report.note(f"No GPS time in the log: {words}")
    report.losses.pop("unsynchronised_packets", None)
    report.timing.unsynchronised_s, report.timing.unsynchronised = 0.0, []
    _shift(report, shift_s)


def _shift(report: IntegrityReport, shift_s: float) -> None:
    report.synchronised, report.time_scale = True, "utc"
    report.gaps = [replace(gap, t_start_s=gap.t_start_s + shift_s) for gap in report.gaps]
    if report.t_first_s is not None and report.t_last_s is not None:
        report.t_first_s, report.t_last_s = report.t_first_s + shift_s, report.t_last_s + shift_s


def _estimated(
    reader: LidarReader,
    scan: LidarScan,
    stated: LidarClockStated,
    first_t_gps_s: float | None,
    voyage: tuple[Trajectory, Rigid, Filters] | None,
) -> tuple[LidarClock, IntegrityReport]:
    """The clock by sentences or by the motion of the boat."""
    report = scan.report
    if stated.source == "nmea":
        found = clock_from_sentences(reader, scan, stated)
        words = "the NMEA sentences that it received tell it"
    else:
        if voyage is None:
            raise ClockError("no trajectory for the clock of the lidar", expected="INS or SBET")
        near_s = None
        if first_t_gps_s is not None:
            near_s = first_t_gps_s - float(
                next(iter(reader.points(scan.clock, max_points=1000))).t_device_s[0]
            )
        found = clock_from_motion(reader, scan.clock, *voyage, near_s=near_s)
        words = "the motion of the boat tells it"
    clock = found.clock
    offsets = tuple(value + stated.offset_s for value in clock.gps_minus_device_s)
    clock = replace(clock, gps_minus_device_s=offsets)
    _tell(report, f"{words}, with a standard deviation of {1000 * clock.sigma_s:.2g} ms", offsets[0])
    report.details["clock"] = {
        "source": stated.source,
        "sigma_s": clock.sigma_s,
        "drift_ppm": 1e6 * found.drift,
        "sigma_drift_ppm": 1e6 * found.sigma_drift,
        **found.facts,
    }
    return clock, report


def clock_from_motion(
    reader: LidarReader,
    clock: LidarClock,
    trajectory: Trajectory,
    mount: Rigid,
    filters: Filters,
    *,
    near_s: float | None = None,
    search_s: float = SEARCH_S,
) -> LidarOffset:
    """Estimate the clock of a lidar from how it moved.

    Parameters
    ----------
    reader, clock : the log and the clock of its scan, which has no GPS time.
    trajectory : of the boat, with covariances as stated.
    mount : of the scanner, with its covariance.
    filters : what they say of the water is used.
    near_s : GPS minus device time, if it is roughly known; then offsets within `search_s` of it are tried.

    Raises
    ------
    CoverageError : too few sweeps that show surfaces, or too few surfaces that were seen again.
    ClockError : no offset is better than all others: the boat hardly turned, or it is another survey.
    """
    turns, packets = sweep_turns(reader, clock)
    rough_s, facts = rough_offset(turns, trajectory, mount.R, near_s=near_s, search_s=search_s)
    ends = packets[[0, -1], 1]
    found = fine_offset(
        reader, clock, trajectory, mount, filters, ends_s=(float(ends[0]), float(ends[1])), rough_s=rough_s
    )
    return replace(found, clock=_drifting(clock, packets, found), facts=facts | found.facts)


def _drifting(clock: LidarClock, packets: ArrayF, found: LidarOffset) -> LidarClock:
    """A clock in stretches whose offsets follow the drift.

    Parameters
    ----------
    packets : (m, 2) index and device time, in order.
    """
    ends = packets[[0, -1], 1]
    sigma_s = float(np.max(np.hypot(found.sigma_offset_s, found.sigma_drift * (ends - found.reference_s))))
    pieces = max(1, int(np.ceil(abs(found.drift) * np.ptp(ends) / _LARGEST_STEP_S)))
    edges = np.linspace(float(ends[0]), float(ends[1]), pieces + 1)
    middle = (edges[1:] + edges[:-1]) / 2
    first = np.interp(edges[:-1], packets[:, 1], packets[:, 0]).astype(np.int64)
    first[0] = 0
    return LidarClock(
        first_packet=tuple(first.tolist()),
        device_extra_s=tuple(clock.extra_s(first).tolist()),
        gps_minus_device_s=tuple((found.offset_s + found.drift * (middle - found.reference_s)).tolist()),
        sigma_s=sigma_s,
    )


def clock_from_sentences(reader: LidarReader, scan: LidarScan, stated: LidarClockStated) -> LidarOffset:
    """The clock of a lidar that received NMEA sentences, but no PPS.

    A sentence names a second and comes some time after it, by the receiver's own delay and the time until the
    lidar sends it on. Of each minute the one that came soonest counts; the receiver's delay is stated.

    Raises
    ------
    ClockError : no sentence with a valid time came.
    """
    rows = np.array(scan.sentences).reshape(-1, 2)
    if not len(rows):
        raise ClockError(
            "no NMEA sentence with a valid time in the lidar log",
            expected="position packets with RMC sentences",
            where=", ".join(str(path) for path in reader.files),
            cure="Set lidar.clock.source to motion, or state lidar.clock.first_packet_utc",
        )
    packets = _packets(reader, scan.clock)
    lead = rows[:, 1] - rows[:, 0]
    minute = np.floor((rows[:, 0] - rows[0, 0]) / 60.0).astype(np.int64)
    soonest = [np.flatnonzero(minute == k)[np.argmax(lead[minute == k])] for k in np.unique(minute)]
    t, offset = rows[soonest, 0], lead[soonest] + stated.nmea_delay_s
    reference_s = float(t.mean())
    A = np.column_stack([np.ones(len(t)), t - reference_s])
    # of so few seconds the soonest is later than the least delay by about the interval of the packets
    sigma = _SOONEST_S
    cov = np.linalg.inv(A.T @ A / sigma**2 + np.diag([0.0, SIGMA_DRIFT**-2]))
    x = cov @ (A.T @ offset) / sigma**2
    found = LidarOffset(
        clock=LidarClock(),
        offset_s=float(x[0]),
        drift=float(x[1]),
        reference_s=reference_s,
        sigma_offset_s=float(np.hypot(np.sqrt(cov[0, 0]), stated.sigma_nmea_delay_s)),
        sigma_drift=float(np.sqrt(cov[1, 1])),
        facts={"sentences": len(rows), "latest_sentence_s": float(np.max(lead.max() - lead))},
    )
    return replace(found, clock=_drifting(scan.clock, packets, found))


# ---------------------------------------------------------------- sweeps and how they turn


def sweep_turns(reader: LidarReader, clock: LidarClock) -> tuple[Turns, ArrayF]:
    """Rotations between sweeps, and packets (m, 2) with index and device time of some.

    Raises
    ------
    CoverageError : fewer than `LEAST_PAIRS` pairs show enough surfaces.
    """
    packets = _packets(reader, clock)
    begin, end = packets[0, 1], packets[-1, 1]
    spans = [(begin, end)]
    if end - begin > 3 * SPAN_S:
        middle = (begin + end) / 2
        spans = [(s, s + SPAN_S) for s in (begin, middle - SPAN_S / 2, end - SPAN_S)]
    rows: list[tuple[ArrayF, ...]] = []
    for first, last in spans:
        rows += _turns_of_span(_Sweeps.read(reader, clock, first, last), first, last)
    if len(rows) < LEAST_PAIRS:
        raise CoverageError(
            f"{len(rows)} pairs of sweeps that show surfaces",
            expected=f"at least {LEAST_PAIRS} within {_NEAR_M:g} to {_FAR_M:g} m",
            cure="State the time of the first packet (lidar.clock.first_packet_utc)",
        )
    phi, info, first_s, second_s = (np.array(column) for column in zip(*rows, strict=True))
    return Turns(phi_rad=phi, info=info, first_s=first_s, second_s=second_s), packets


def _packets(reader: LidarReader, clock: LidarClock) -> ArrayF:
    """Packets (m, 2), index and device time of the first and last of each block of points."""
    rows = [[b.packet[k], b.t_device_s[k]] for b in reader.points(clock) for k in (0, -1) if b.n]
    if not rows:
        raise CoverageError("no lidar points", expected="a recording with returns")
    packets = np.array(rows)
    return np.asarray(packets[np.unique(packets[:, 1], return_index=True)[1]])


@dataclass(frozen=True, slots=True, kw_only=True)
class _Sweeps:
    """Points of a stretch in the order of time, and how long the scanner takes for a revolution."""

    xyz_m: ArrayF
    t_s: ArrayF
    period_s: float

    @classmethod
    def read(cls, reader: LidarReader, clock: LidarClock, first: float, last: float) -> "_Sweeps":
        """Sweeps of a log between two times of the device, seconds."""
        parts: list[ArrayF] = [np.zeros((0, 4))]
        turned = seconds = 0.0
        for block in reader.points(clock):
            t = block.t_device_s
            use = (t >= first) & (t < last + PAIR_S)
            if not use.any():
                continue
            turn = np.diff(np.unwrap(block.azimuth_rad[use].astype(np.float64)))
            turned, seconds = turned + float(turn.sum()), seconds + float(np.ptp(t[use]))
            use &= (block.range_m > _NEAR_M) & (block.range_m < _FAR_M)
            parts.append(np.column_stack([block.xyz_scs_m[use], t[use]]))
        rows = np.concatenate(parts)
        rows = rows[np.argsort(rows[:, 3], kind="stable")]
        period = 2 * np.pi * seconds / turned if turned > 0 else STEP_S
        return cls(xyz_m=rows[:, :3], t_s=rows[:, 3], period_s=float(np.clip(period, 0.04, 0.25)))

    def at(self, begin_s: float) -> tuple[ArrayF, ArrayF]:
        """Thinned points (n, 3) of one revolution and their times (n,)."""
        a, b = np.searchsorted(self.t_s, np.array([begin_s, begin_s + self.period_s]))
        xyz, t = self.xyz_m[a:b], self.t_s[a:b]
        _, keep = np.unique(np.floor(xyz / _VOXEL_M).astype(np.int32), axis=0, return_index=True)
        return xyz[keep], t[keep]


def _turns_of_span(sweeps: _Sweeps, first: float, last: float) -> Iterator[tuple[ArrayF, ...]]:
    surfaces: dict[int, tuple[Any, ...]] = {}
    lag = round(PAIR_S / STEP_S)
    guess = np.zeros(6)
    for k in range(int((last - first - sweeps.period_s) / STEP_S)):
        points, t = sweeps.at(first + k * STEP_S)
        surfaces[k] = (points, t, *_normals(points))
        if k < lag:
            continue
        found = _registered(surfaces.pop(k - lag), surfaces[k], guess)
        guess = np.zeros(6) if found is None else found[0]
        if found is not None:
            _, *row = found
            yield tuple(row)


def _normals(points: ArrayF) -> tuple[cKDTree, ArrayF, ArrayB]:
    """Tree, normals (n, 3) and whether the surroundings of each point are a surface."""
    tree = cKDTree(points)
    if len(points) < _FEWEST_POINTS:
        return tree, np.zeros((len(points), 3)), np.zeros(len(points), np.bool_)
    distance, near = (np.asarray(found) for found in tree.query(points, k=_NEIGHBOURS))
    around = points[near] - points[near].mean(axis=1, keepdims=True)
    value, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", around, around) / _NEIGHBOURS)
    flat = (value[:, 0] < 0.1 * value[:, 1]) & (value[:, 1] > 0.1 * value[:, 2]) & (distance[:, -1] < 2.0)
    return tree, axes[:, :, 0], flat


def _registered(one: tuple[Any, ...], two: tuple[Any, ...], guess: ArrayF) -> tuple[ArrayF, ...] | None:
    """Motion (6,), rotation vector, weight, times of both sweeps by component; None without surfaces."""
    points, t_one = one[0], one[1]
    target, t_two, tree, normal, flat = two
    turn, shift = guess[:3], guess[3:]
    for reach in _REACH_M:
        moved = Rotation.from_rotvec(turn).apply(points) + shift
        distance, partner = tree.query(moved, distance_upper_bound=reach)
        use = np.flatnonzero(np.isfinite(distance))
        use = use[flat[partner[use]]]
        if len(use) < _FEWEST_POINTS:
            return None
        n, at = normal[partner[use]], partner[use]
        off = np.einsum("ni,ni->n", n, target[at] - moved[use])
        A = np.hstack([np.cross(moved[use], n), n])
        scale = 1.4826 * np.median(np.abs(off)) + 1e-6
        weight = np.clip(1 - (off / (4.685 * scale)) ** 2, 0, None) ** 2
        normal_matrix = A.T @ (weight[:, None] * A)
        try:
            inverse = np.linalg.inv(normal_matrix)
        except np.linalg.LinAlgError:
            return None
        step = inverse @ (A.T @ (weight * off))
        turn = (Rotation.from_rotvec(step[:3]) * Rotation.from_rotvec(turn)).as_rotvec()
        shift = Rotation.from_rotvec(step[:3]).apply(shift) + step[3:]
    share = (inverse @ (A.T * weight))[:3] * A[:, :3].T  # of each point in each component, sums to one
    info = np.linalg.inv(inverse[:3, :3]) / scale**2
    return np.concatenate([turn, shift]), turn, info, share @ t_one[use], share @ t_two[at]


# ---------------------------------------------------------------- the trajectory beside them


@dataclass(frozen=True, slots=True, kw_only=True)
class _Theta:
    """Sum of body rotations (n, 3) at times (n,), and how many gaps came before."""

    t_s: ArrayF
    theta_rad: ArrayF
    gaps: ArrayF

    @classmethod
    def of(cls, trajectory: Trajectory) -> "_Theta":
        """Turns from node to node, summed; nodes that are not valid are gaps."""
        use = trajectory.valid
        R = Rotation.from_quat(trajectory.quaternion_wcs_ics[use])
        steps = np.cumsum((R[:-1].inv() * R[1:]).as_rotvec(), axis=0)
        gap = np.diff(np.flatnonzero(use)) > 1
        return cls(
            t_s=trajectory.t_gps_s[use],
            theta_rad=np.concatenate([np.zeros((1, 3)), steps]),
            gaps=np.concatenate([[0.0], np.cumsum(gap)]),
        )

    def between(self, first_s: ArrayF, second_s: ArrayF) -> ArrayF:
        """Rotation vectors (n, 3) from (n, 3) to (n, 3), each component of its own times."""
        return np.column_stack(
            [
                np.interp(second_s[:, c], self.t_s, self.theta_rad[:, c])
                - np.interp(first_s[:, c], self.t_s, self.theta_rad[:, c])
                for c in range(3)
            ]
        )

    def covers(self, first_s: ArrayF, second_s: ArrayF) -> ArrayB:
        """Whether there are poses without a gap from (n,) to (n,)."""
        inside = (first_s > self.t_s[0]) & (second_s < self.t_s[-1])
        gap = np.interp(second_s, self.t_s, self.gaps) - np.interp(first_s, self.t_s, self.gaps)
        return np.asarray(inside & (gap == 0))


def rough_offset(
    turns: Turns, trajectory: Trajectory, R_ics_scs: ArrayF, *, near_s: float | None, search_s: float
) -> tuple[float, dict[str, Any]]:
    """GPS minus device time of the best correlation of angular rates, and numbers for a report.

    Raises
    ------
    ClockError : no offset is possible, or another one is nearly as good.
    """
    theta = _Theta.of(trajectory)
    own = replace(theta, theta_rad=-theta.theta_rad @ R_ics_scs)  # in the scanner's frame
    weight = np.diagonal(turns.info, axis1=1, axis2=2)
    low, high = theta.t_s[0] - turns.second_s.max(), theta.t_s[-1] - turns.first_s.min()
    if near_s is not None:
        low, high = max(low, near_s - search_s), min(high, near_s + search_s)
    tried = np.arange(low, high, _COARSE_S)
    misfit = np.array([_misfit(turns, own, weight, offset_s) for offset_s in tried])
    if not np.isfinite(misfit).any():
        raise ClockError(
            "no offset of the lidar's clock puts its sweeps within the trajectory",
            expected="INS and lidar of one survey",
            cure="Check the logs, and lidar.clock.first_packet_utc",
        )
    best = int(np.nanargmin(misfit))
    others = misfit[np.abs(tried - tried[best]) > _BESIDE_S]
    second = float(np.nanmin(others)) if np.isfinite(others).any() else np.inf
    # pairs within `PAIR_S` of each other are one observation
    independent = len(weight) * STEP_S / PAIR_S
    sigmas = float(np.sqrt(max(second / misfit[best] - 1, 0) * independent))
    if sigmas < LEAST_SIGMAS:
        raise ClockError(
            f"the motion of the lidar fits the trajectory at one time nearly as well as at another ("
            f"{sigmas:.1f} sigmas apart)",
            expected=f"at least {LEAST_SIGMAS:g} sigmas: a boat that rolls or turns",
            cure="State the time of the first packet: lidar.clock.first_packet_utc",
        )
    return float(tried[best]), {"pairs_of_sweeps": len(weight), "better_than_the_next_by_sigmas": sigmas}


def _misfit(turns: Turns, own: _Theta, weight: ArrayF, offset_s: float) -> float:
    """Mean weighted square that the trajectory does not explain; NaN if it covers less than 80 % of all."""
    first, second = turns.first_s + offset_s, turns.second_s + offset_s
    use = own.covers(first.min(axis=1), second.max(axis=1))
    if use.mean() < 0.8:
        return np.nan
    off = turns.phi_rad[use] - own.between(first[use], second[use])
    off -= np.average(off, axis=0, weights=weight[use])
    return float(np.average(off**2, weights=weight[use]))


# ---------------------------------------------------------------- planes that were seen again


def fine_offset(
    reader: LidarReader,
    clock: LidarClock,
    trajectory: Trajectory,
    mount: Rigid,
    filters: Filters,
    *,
    ends_s: tuple[float, float],
    rough_s: float,
) -> LidarOffset:
    """Offset and drift of the device's clock for which planes that were seen again are thinnest.

    Parameters
    ----------
    reader, clock, trajectory, mount, filters : as for `clock_from_motion`.
    ends_s : first and last device time.
    rough_s : GPS minus device time, to some tenths of a second.

    Raises
    ------
    CoverageError : fewer than `LEAST_PLANES` planes were seen again.
    ClockError : the adjustment does not converge.
    """
    windows = _device_points(reader, clock, windows_of(*ends_s))
    reference_s = float(np.mean(np.concatenate([w[:, 3] for w in windows])))
    x = np.array([rough_s, *np.zeros(7)])  # offset, drift, rotation and shift of the mount
    prior = np.zeros((8, 8))
    prior[1, 1] = SIGMA_DRIFT**-2
    prior[2:, 2:] = np.linalg.inv(mount.cov[np.ix_(_MOUNT, _MOUNT)] + _LEAST_MOUNT**2 * np.eye(6))
    for _ in range(_MOST_ROUNDS):
        rows = [_rows(w, trajectory, mount, filters, x[0] + x[1] * (w[:, 3] - reference_s)) for w in windows]
        found = [row for row in rows if row is not None]
        planes = sum(row[3] for row in found)
        if planes < LEAST_PLANES:
            raise CoverageError(
                f"{planes} planes were seen again",
                expected=f"at least {LEAST_PLANES}",
                cure="State the time of the first packet: lidar.clock.first_packet_utc",
            )
        d, J, t = (np.concatenate([row[k] for row in found]) for k in range(3))
        J = np.column_stack([J[:, 0], J[:, 0] * (t - reference_s), J[:, 1:]])
        sigma = 1.4826 * np.median(np.abs(d))
        weight = np.clip(1 - (d / (4.685 * sigma)) ** 2, 0, None) ** 2 / sigma**2
        # points of a moment err together: so many of them count as one
        weight *= len(np.unique(np.floor(t / STEP_S))) * _PLANES_OF_A_MOMENT / len(d)
        scores = J * (weight * d)[:, None]
        H = J.T @ (weight[:, None] * J) + prior
        step = -np.linalg.solve(H, scores.sum(axis=0) + prior @ np.r_[0.0, x[1:]])
        x = x + step
        if abs(step[0]) < _SMALL_STEP_S:
            break
    else:
        raise ClockError(
            f"the time of the lidar does not converge; the last step was {1000 * step[0]:.2g} ms",
            expected=f"steps below {1000 * _SMALL_STEP_S:g} ms",
            cure="State the time of the first packet: lidar.clock.first_packet_utc",
        )
    cov = _covariance(H, scores, t, prior)
    by_attitude_s = attitude_share_s(trajectory, float(x[0] + t.min()), float(x[0] + t.max()))
    return LidarOffset(
        clock=LidarClock(),
        offset_s=float(x[0]),
        drift=float(x[1]),
        reference_s=reference_s,
        sigma_offset_s=float(np.hypot(np.sqrt(cov[0, 0]), by_attitude_s)),
        # the slope of even observations over a span, whose mean has that sigma; what is known before holds
        sigma_drift=min(
            SIGMA_DRIFT, float(np.hypot(np.sqrt(cov[1, 1]), np.sqrt(12.0) * by_attitude_s / np.ptp(t)))
        ),
        facts={
            "planes": planes,
            "points_on_planes": len(d),
            "scatter_m": float(sigma),
            "sigma_by_attitudes_s": by_attitude_s,
        },
    )


def attitude_share_s(trajectory: Trajectory, first_s: float, last_s: float) -> float:
    """Standard deviation of the offset from errors of the attitudes alone, in seconds.

    An error of roll, pitch or heading that swings as the boat does is a delay. Of a Gauss-Markov process with
    standard deviation ``sigma`` and any correlation time, the spectral density at the angular frequency
    ``w`` is at most ``sigma^2 / w``. Over the time ``T`` the delay by a turn rate of root mean square ``r``
    then has the variance ``sigma^2 / (w r^2 T)``; the three axes are weighted by their inverse.

    Parameters
    ----------
    trajectory : with covariances as stated.
    first_s, last_s : GPS time of the span.
    """
    theta = _Theta.of(trajectory)
    at = np.arange(max(first_s, theta.t_s[0]), min(last_s, theta.t_s[-1]) - PAIR_S, STEP_S)
    at = at[theta.covers(at, at + PAIR_S)]
    # over `PAIR_S`: noise from pose to pose is no turn
    rate = theta.between(*(np.column_stack([t] * 3) for t in (at, at + PAIR_S))) / PAIR_S
    square = np.mean(rate**2, axis=0)
    w = np.sqrt(np.mean((np.diff(rate, axis=0) / STEP_S) ** 2, axis=0) / square)
    sigma = np.sqrt(np.mean(trajectory.sigma_roll_pitch_heading_rad()[trajectory.valid] ** 2, axis=0))
    return float(np.sum(w * square * len(at) * STEP_S / sigma**2) ** -0.5)


def _covariance(H: ArrayF, scores: ArrayF, t: ArrayF, prior: ArrayF) -> ArrayF:
    """Covariance (8, 8) of a fit whose scores (n, 8) are correlated over `CORRELATED_S`."""
    moment = np.floor((t - t.min()) / STEP_S).astype(np.int64)
    dense = sums(scores, moment, int(moment.max()) + 1)
    meat = dense.T @ dense + prior
    lags = round(CORRELATED_S / STEP_S)
    for lag in range(1, min(lags, len(dense) - 1) + 1):
        both = dense[lag:].T @ dense[:-lag]
        meat += (1 - lag / (lags + 1)) * (both + both.T)
    inverse = np.linalg.inv(H)
    return np.asarray(inverse @ meat @ inverse)


def _rows(
    points: ArrayF, trajectory: Trajectory, mount: Rigid, filters: Filters, late_s: ArrayF
) -> tuple[ArrayF, ArrayF, ArrayF, int] | None:
    """Distances (n,) from planes, their changes with time and mount (n, 7), device times, number of planes.

    What the planes' own parameters explain is taken out of all.
    """
    xyz, t = points[:, :3], points[:, 3] + late_s
    at = [georeference_points(xyz, t + h, trajectory, mount) for h in (-_HALF_S, 0.0, _HALF_S)]
    use = at[0].has_pose & at[1].has_pose & at[2].has_pose
    if filters.below_water_m is not None:
        use &= at[1].points_wcs_m[:, 2] > water_level_m(t, trajectory, filters.water_line_ics_m)
    if use.sum() < _FEWEST_POINTS:
        return None
    before, x, after = (each.points_wcs_m[use] for each in at)
    planes = planes_seen_again(x, t[use])
    if not planes.n:
        return None
    order, owner = planes.order, planes.owner
    local = np.einsum("ni,nij->nj", x[order] - planes.centre_m[owner], planes.axes[owner])
    normal = planes.axes[owner, :, 0]
    change = np.einsum("ni,ni->n", normal, (after - before)[order]) / (2 * _HALF_S)
    _, R, _ = trajectory.at(t[use][order])
    normal_ics = np.einsum("nji,nj->ni", R, normal)
    arm_ics = xyz[use][order] @ mount.R.T
    both = np.column_stack([local[:, 0], change, np.cross(arm_ics, normal_ics), normal_ics])
    plane = np.column_stack([np.ones(len(local)), local[:, 1:]])
    gram = sums((plane[:, :, None] * plane[:, None, :]).reshape(-1, 9), owner, planes.n).reshape(-1, 3, 3)
    right = sums((plane[:, :, None] * both[:, None, :]).reshape(len(both), -1), owner, planes.n)
    own = np.linalg.solve(gram + 1e-9 * np.eye(3), right.reshape(planes.n, 3, -1))
    free = both - np.einsum("mi,mik->mk", plane, own[owner])
    return free[:, 0], free[:, 1:], points[use][order, 3], planes.n


def _device_points(
    reader: LidarReader, clock: LidarClock, windows: Sequence[tuple[float, float]]
) -> list[ArrayF]:
    """Points (n, 4) of windows, scs and device time; a random sample of each."""
    parts: list[list[ArrayF]] = [[np.zeros((0, 4))] for _ in windows]
    for b in reader.points(clock):
        for part, (start_s, length_s) in zip(parts, windows, strict=True):
            use = (b.range_m > _NEAR_M) & (b.t_device_s >= start_s) & (b.t_device_s < start_s + length_s)
            part.append(np.column_stack([b.xyz_scs_m, b.t_device_s])[use])
    rng = np.random.default_rng(len(windows))
    rows = [np.concatenate(part) for part in parts]
    return [r[np.sort(rng.permutation(len(r))[:_MOST_POINTS])] for r in rows]
