"""The table kinds that the readers produce. Angles and positions are named with their units and frames."""

from typing import Final

import pyarrow as pa

from thalweg.core import column, table_kind

_F = pa.float64()
_T_GPS = column(
    "t_gps_s", _F, "s", "adjusted standard GPS time; NaN where the stream had no valid GPS/UTC time"
)

INS_STATE = table_kind(
    "ins_state",
    1,
    [
        _T_GPS,
        column("t_device_s", _F, "s", "Unix time of the device's own clock (UTC once initialised)"),
        column("lat_deg", _F, "deg", "geodetic latitude of the configured reference point"),
        column("lon_deg", _F, "deg", "geodetic longitude"),
        column("h_ell_m", _F, "m", "height above the ellipsoid"),
        column("v_north_mps", _F, "m/s", "velocity north"),
        column("v_east_mps", _F, "m/s", "velocity east"),
        column("v_down_mps", _F, "m/s", "velocity down"),
        column("roll_rad", _F, "rad", "roll, right side down"),
        column("pitch_rad", _F, "rad", "pitch, nose up"),
        column("heading_rad", _F, "rad", "heading, clockwise from true north, [0, 2 pi)"),
        column("rate_x_radps", _F, "rad/s", "angular velocity about body x (forward)"),
        column("rate_y_radps", _F, "rad/s", "angular velocity about body y (right)"),
        column("rate_z_radps", _F, "rad/s", "angular velocity about body z (down)"),
        column("sigma_north_m", _F, "m", "standard deviation north, as the filter states it"),
        column("sigma_east_m", _F, "m", "standard deviation east"),
        column("sigma_up_m", _F, "m", "standard deviation of the height"),
        column("sigma_roll_rad", _F, "rad", "standard deviation of roll; NaN if not logged"),
        column("sigma_pitch_rad", _F, "rad", "standard deviation of pitch; NaN if not logged"),
        column("sigma_heading_rad", _F, "rad", "standard deviation of heading; NaN if not logged"),
        column("fix", pa.string(), "1", "none, 2d, 3d, sbas, dgnss, omnistar, float, fixed"),
        column("system_status", pa.uint16(), "1", "ANPP system status word"),
        column("filter_status", pa.uint16(), "1", "ANPP filter status word; 7 in a finished trajectory"),
    ],
)
NAVIGATION_INITIALISED: Final = 0b111
"""Bits of the filter status (orientation, navigation, heading) without which a position is arbitrary."""

GNSS_POSITION = table_kind(
    "gnss_position",
    1,
    [
        _T_GPS,
        column("lat_deg", _F, "deg", "geodetic latitude of the antenna"),
        column("lon_deg", _F, "deg", "geodetic longitude of the antenna"),
        column("h_ell_m", _F, "m", "height above the ellipsoid; NaN if unknown"),
        column("fix", pa.string(), "1", "none, single, sbas, dgnss, float, fixed, ppp, dead_reckoning"),
        column("n_sats", pa.int32(), "1", "satellites used, -1 if unknown"),
        column("sigma_east_m", _F, "m", "standard deviation east; NaN if unknown"),
        column("sigma_north_m", _F, "m", "standard deviation north"),
        column("sigma_up_m", _F, "m", "standard deviation up"),
        column("cov_en_m2", _F, "m^2", "covariance east-north; NaN if unknown"),
        column("cov_eu_m2", _F, "m^2", "covariance east-up"),
        column("cov_nu_m2", _F, "m^2", "covariance north-up"),
        column("age_s", _F, "s", "age of the corrections; NaN if unknown"),
        column("ratio", _F, "1", "ambiguity ratio; NaN if unknown"),
    ],
)

DEPTH = table_kind(
    "depth",
    1,
    [
        _T_GPS,
        column("t_host_s", _F, "s", "logger's clock (Unix time), NaN if the log has none"),
        column("t_day_s", _F, "s", "UTC second of the day of the sentence before it; NaN if none"),
        column("depth_m", _F, "m", "depth below the transducer as measured; 0: no bottom was seen"),
        column("offset_m", _F, "m", "DPT offset: > 0 transducer to water line, < 0 to keel; NaN if none"),
        column("sentence", pa.string(), "1", "DPT, DBT, DBS or ANPP53"),
        column("line", pa.int64(), "1", "line (NMEA) or packet (ANPP) of the log, from 1"),
    ],
)
