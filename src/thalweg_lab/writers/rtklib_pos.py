"""Solution files as RTKLIB writes them (RTKLIB 2.4.3 manual, B.1 "Positioning Solution File").

Variant: latitude, longitude and ellipsoidal height in degrees and metres, GPST as calendar time.
"""

import datetime as dt
from collections.abc import Iterable

from thalweg_lab.writers.nmea import moment

_GPS_EPOCH = dt.datetime(1980, 1, 6, tzinfo=dt.UTC)

_COLUMNS = (
    "%  GPST                  latitude(deg) longitude(deg)  height(m)   Q  ns   sdn(m)   sde(m)   sdu(m)"
    "  sdne(m)  sdeu(m)  sdun(m) age(s)  ratio"
)


def _epoch(gpst_us: int) -> str:
    """Calendar time, with GPST counted like UTC without leap seconds since 1980-01-06."""
    gps_us = gpst_us - round((_GPS_EPOCH.timestamp()) * 1e6)
    week, rest = divmod(gps_us, 604_800_000_000)
    t = moment(gpst_us)
    return f"{t:%Y/%m/%d %H:%M:%S}.{t.microsecond // 100_000} GPST (week{week:04d} {rest / 1e6:8.1f}s)"


def header(
    program: str, first_us: int, last_us: int, base_llh: tuple[float, float, float] | None = None
) -> str:
    """Comment lines above the solutions; without a base those of a single-frequency code solution."""
    return "\n".join(
        [
            f"% program   : {program}",
            "% inp file  : rover.obs",
            "% inp file  : base.obs",
            "% inp file  : rover.nav",
            f"% obs start : {_epoch(first_us)}",
            f"% obs end   : {_epoch(last_us)}",
            f"% pos mode  : {'single' if base_llh is None else 'kinematic'}",
            f"% freqs     : {'L1' if base_llh is None else 'L1+L2'}",
            "% solution  : combined",
            "% elev mask : 15.0 deg",
            "% dynamics  : off",
            "% tidecorr  : off",
            "% ionos opt : broadcast",
            "% tropo opt : saastamoinen",
            "% ephemeris : broadcast",
            "% navi sys  : gps galileo",
            "% amb res   : continuous",
            "% val thres : 3.0",
            "% antenna1  :                       ( 0.0000  0.0000  0.0000)",
            "% antenna2  :                       ( 0.0000  0.0000  0.0000)",
            *([] if base_llh is None else ["% ref pos   :{:14.9f} {:14.9f} {:10.4f}".format(*base_llh)]),
            "%",
            "% (lat/lon/height=WGS84/ellipsoidal,Q=1:fix,2:float,3:sbas,4:dgps,5:single,6:ppp,"
            "ns=# of satellites)",
            _COLUMNS,
            "",
        ]
    )


def solution(
    gpst_us: int,
    llh: tuple[float, float, float],
    quality: int,
    satellites: int,
    sigma_neu_m: Iterable[float],
    age_s: float,
    ratio: float,
) -> str:
    """One line of the file.

    Parameters
    ----------
    gpst_us : GPS time as microseconds since 1970 without leap seconds.
    llh : latitude, longitude (degrees), ellipsoidal height (m).
    quality : 1 fixed, 2 float, 5 single.
    satellites : number used.
    sigma_neu_m : standard deviations north, east, up; the errors are uncorrelated.
    age_s, ratio : age of the base's data and ratio of the ambiguity test.
    """
    t = moment(gpst_us)
    lat, lon, height = llh
    n, e, u = sigma_neu_m
    return (
        f"{t:%Y/%m/%d %H:%M:%S}.{t.microsecond // 1000:03d} {lat:14.9f} {lon:14.9f} {height:10.4f}"
        f" {quality:3d} {satellites:3d} {n:8.4f} {e:8.4f} {u:8.4f}"
        f" {0.0:8.4f} {0.0:8.4f} {0.0:8.4f} {age_s:6.2f} {ratio:6.1f}\n"
    )
