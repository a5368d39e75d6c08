"""Messages of the Swift Binary Protocol, encoded by Swift's own library (SBP specification v6)."""

import datetime as dt
from typing import Final, Literal

from sbp.navigation import MsgGPSTime, MsgPosLLH, MsgPosLLHCov, MsgUtcTime, MsgVelNED
from sbp.observation import MsgBasePosECEF
from sbp.system import MsgHeartbeat

ROVER: Final = 0x2EFB
"""Sender of the boat's receiver."""
BASE: Final = 0
"""Sender of what arrives over the radio."""

MODES: Final = {"fixed": 4, "float": 3, "single": 1}


def heartbeat() -> bytes:
    """MsgHeartbeat: protocol 6.0, antenna present."""
    return bytes(MsgHeartbeat(sender=ROVER, flags=(1 << 31) | (6 << 16)).to_binary())


def base_position(ecef_m: tuple[float, float, float]) -> bytes:
    """MsgBasePosECEF of the base antenna."""
    x, y, z = ecef_m
    return bytes(MsgBasePosECEF(sender=BASE, x=x, y=y, z=z).to_binary())


def times(week: int, tow_ms: int, utc: dt.datetime) -> bytes:
    """MsgGPSTime and MsgUtcTime of an epoch."""
    gps = MsgGPSTime(sender=ROVER, wn=week, tow=tow_ms, ns_residual=0, flags=1)
    # Flags: time from GNSS (1), UTC offset decoded this session (2 << 3).
    civil = MsgUtcTime(
        sender=ROVER,
        flags=1 | 2 << 3,
        tow=tow_ms,
        year=utc.year,
        month=utc.month,
        day=utc.day,
        hours=utc.hour,
        minutes=utc.minute,
        seconds=utc.second,
        ns=utc.microsecond * 1000,
    )
    return bytes(gps.to_binary()) + bytes(civil.to_binary())


def position(
    tow_ms: int,
    llh: tuple[float, float, float],
    sigma_enu_m: tuple[float, float, float],
    mode: Literal["fixed", "float", "single"],
    satellites: int,
) -> bytes:
    """MsgPosLLH and MsgPosLLHCov; ``llh`` in degrees and ellipsoidal metres, errors uncorrelated."""
    lat, lon, height = llh
    east, north, up = sigma_enu_m
    plain = MsgPosLLH(
        sender=ROVER,
        tow=tow_ms,
        lat=lat,
        lon=lon,
        height=height,
        h_accuracy=min(65535, round(1000 * ((east**2 + north**2) / 2) ** 0.5)),
        v_accuracy=min(65535, round(1000 * up)),
        n_sats=satellites,
        flags=MODES[mode],
    )
    full = MsgPosLLHCov(
        sender=ROVER,
        tow=tow_ms,
        lat=lat,
        lon=lon,
        height=height,
        cov_n_n=north**2,
        cov_n_e=0.0,
        cov_n_d=0.0,
        cov_e_e=east**2,
        cov_e_d=0.0,
        cov_d_d=up**2,
        n_sats=satellites,
        flags=MODES[mode],
    )
    return bytes(plain.to_binary()) + bytes(full.to_binary())


def velocity(tow_ms: int, ned_mps: tuple[float, float, float], sigma_mps: float, satellites: int) -> bytes:
    """MsgVelNED, measured by Doppler, with its standard deviation in each direction."""
    n, e, d = (round(1000 * v) for v in ned_mps)
    accuracy = min(65535, round(1000 * sigma_mps))
    return bytes(
        MsgVelNED(
            sender=ROVER,
            tow=tow_ms,
            n=n,
            e=e,
            d=d,
            h_accuracy=accuracy,
            v_accuracy=accuracy,
            n_sats=satellites,
            flags=1,
        ).to_binary()
    )
