"""What tests of the lidar are made of."""

import numpy as np

from thalweg.ingest import PointBlock


def block_of(t_gps_s, xyz_scs_m, **columns):
    """Points of one packet; ring, laser, intensity and numbers of returns are 1 unless they are given."""
    one, zero = np.ones(len(t_gps_s), np.uint8), np.zeros(len(t_gps_s), int)
    distance = np.linalg.norm(xyz_scs_m, axis=1).astype(np.float32)
    given = dict.fromkeys(("ring", "laser", "intensity", "return_number", "n_returns"), one)
    given |= {"t_device_s": t_gps_s, "range_m": distance, "azimuth_rad": zero.astype(np.float32)}
    return PointBlock(t_gps_s=t_gps_s, xyz_scs_m=xyz_scs_m.astype(np.float32), packet=zero, **given | columns)
