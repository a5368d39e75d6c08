"""The table kinds that the readers produce. Angles and positions are named with their units and frames."""

from typing import Final

import pyarrow as pa

from thalweg.core import column, table_kind

_T_GPS = column("t_gps_s", "s", "adjusted standard GPS time; NaN where the stream had no valid GPS/UTC time")

INS_STATE = table_kind(
    "ins_state",
    1,
    [
        _T_GPS,
        column("t_device_s", "s", "Unix time of the device's own clock (UTC once initialised)"),
        column("lat_deg", "deg", "geodetic latitude of the configured reference point"),
        column("lon_deg", "deg", "geodetic longitude"),
        column("h_ell_m", "m", "height above the ellipsoid"),
        column("v_north_mps", "m/s", "velocity north"),
        column("v_east_mps", "m/s", "velocity east"),
        column("v_down_mps", "m/s", "velocity down"),
        column("roll_rad", "rad", "roll, right side down"),
        column("pitch_rad", "rad", "pitch, nose up"),
        column("heading_rad", "rad", "heading, clockwise from true north, [0, 2 pi)"),
        column("rate_x_radps", "rad/s", "angular velocity about body x (forward)"),
        column("rate_y_radps", "rad/s", "angular velocity about body y (right)"),
        column("rate_z_radps", "rad/s", "angular velocity about body z (down)"),
        column("sigma_north_m", "m", "standard deviation north, as the filter states it"),
        column("sigma_east_m", "m", "standard deviation east"),
        column("sigma_up_m", "m", "standard deviation of the height"),
        column("sigma_roll_rad", "rad", "standard deviation of roll; NaN if not logged"),
        column("sigma_pitch_rad", "rad", "standard deviation of pitch; NaN if not logged"),
        column("sigma_heading_rad", "rad", "standard deviation of heading; NaN if not logged"),
        column("fix", "1", "none, 2d, 3d, sbas, dgnss, omnistar, float, fixed", pa.string()),
        column("system_status", "1", "ANPP system status word", pa.uint16()),
        column("filter_status", "1", "ANPP filter status word; 7 in a finished trajectory", pa.uint16()),
    ],
)
NAVIGATION_INITIALISED: Final = 0b111
"""Bits of the filter status (orientation, navigation, heading) without which a position is arbitrary."""

GNSS_POSITION = table_kind(
    "gnss_position",
    1,
    [
        _T_GPS,
        column("lat_deg", "deg", "geodetic latitude of the antenna"),
        column("lon_deg", "deg", "geodetic longitude of the antenna"),
        column("h_ell_m", "m", "height above the ellipsoid; NaN if unknown"),
        column("fix", "1", "none, single, sbas, dgnss, float, fixed, ppp, dead_reckoning", pa.string()),
        column("n_sats", "1", "satellites used, -1 if unknown", pa.int32()),
        column("sigma_east_m", "m", "standard deviation east; NaN if unknown"),
        column("sigma_north_m", "m", "standard deviation north"),
        column("sigma_up_m", "m", "standard deviation up"),
        column("cov_en_m2", "m^2", "covariance east-north; NaN if unknown"),
        column("cov_eu_m2", "m^2", "covariance east-up"),
        column("cov_nu_m2", "m^2", "covariance north-up"),
        column("age_s", "s", "age of the corrections; NaN if unknown"),
        column("ratio", "1", "ambiguity ratio; NaN if unknown"),
    ],
)

DEPTH = table_kind(
    "depth",
    1,
    [
        _T_GPS,
        column("t_host_s", "s", "logger's clock (Unix time), NaN if the log has none"),
        column("t_day_s", "s", "UTC second of the day of the sentence before it; NaN if none"),
        column("depth_m", "m", "depth below the transducer as measured; 0: no bottom was seen"),
        column("offset_m", "m", "DPT offset: > 0 transducer to water line, < 0 to keel; NaN if none"),
        column("sentence", "1", "DPT, DBT, DBS or ANPP53", pa.string()),
        column("line", "1", "line (NMEA) or packet (ANPP) of the log, from 1", pa.int64()),
    ],
)
