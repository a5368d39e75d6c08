"""NMEA 0183 sentences (NMEA 0183 v4.10; field order as in its sections on RMC, GGA, ZDA, DPT, DBT)."""

import datetime as dt


def sentence(body: str) -> str:
    """A sentence with ``$`` and checksum, without line end.

    Examples
    --------
    >>> sentence("SDDBT,7.7,f,2.3,M,1.3,F")
    '$SDDBT,7.7,f,2.3,M,1.3,F*05'
    """
    check = 0
    for byte in body.encode("ascii"):
        check ^= byte
    return f"${body}*{check:02X}"


def moment(unix_us: int) -> dt.datetime:
    """UTC of whole microseconds since 1970."""
    return dt.datetime(1970, 1, 1, tzinfo=dt.UTC) + dt.timedelta(microseconds=unix_us)


def _clock(t: dt.datetime) -> str:
    return f"{t:%H%M%S}.{t.microsecond // 10_000:02d}"


def _place(lat_deg: float, lon_deg: float) -> str:
    parts = []
    for value, width, letters in ((lat_deg, 2, "NS"), (lon_deg, 3, "EW")):
        # Rounded first: 59.99999999 minutes must not print as 60.
        tenmillionths = round(abs(value) * 60 * 10**7)
        degrees, rest = divmod(tenmillionths, 60 * 10**7)
        parts.append(f"{degrees:0{width}d}{rest // 10**7:02d}.{rest % 10**7:07d},{letters[value < 0]}")
    return ",".join(parts)


def rmc(unix_us: int, lat_deg: float, lon_deg: float, speed_mps: float, course_deg: float) -> str:
    """GPRMC: time, position, speed over ground in knots, course, date."""
    t = moment(unix_us)
    knots = speed_mps * 3600 / 1852
    return sentence(
        f"GPRMC,{_clock(t)},A,{_place(lat_deg, lon_deg)},{knots:.3f},{course_deg % 360:.1f},"
        f"{t:%d%m%y},0.0,E,A"
    )


def gga(unix_us: int, lat_deg: float, lon_deg: float, h_geoid_m: float, undulation_m: float) -> str:
    """GPGGA: time, position, height above the geoid and the geoid's above the ellipsoid."""
    return sentence(
        f"GPGGA,{_clock(moment(unix_us))},{_place(lat_deg, lon_deg)},2,14,0.8,"
        f"{h_geoid_m:.3f},M,{undulation_m:.3f},M,1.0,0001"
    )


def zda(unix_us: int) -> str:
    """GPZDA: time and date."""
    t = moment(unix_us)
    return sentence(f"GPZDA,{_clock(t)},{t:%d,%m,%Y},00,00")


def dpt(depth_m: float, offset_m: float, scale_m: float) -> str:
    """SDDPT: depth below the transducer, offset (> 0 to the water line, < 0 to the keel), range scale."""
    return sentence(f"SDDPT,{depth_m:.2f},{offset_m:.2f},{scale_m:.1f}")


def dbt(depth_m: float) -> str:
    """SDDBT: depth below the transducer in feet, metres and fathoms."""
    return sentence(f"SDDBT,{depth_m / 0.3048:.2f},f,{depth_m:.2f},M,{depth_m / 1.8288:.2f},F")
