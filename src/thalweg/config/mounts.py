"""Section ``mounts``: where the sensors sit in the body frame of the INS.

Body frame ics: x forward, y right, z down. ``R_ics_scs = R_x(omega) R_y(phi) R_z(kappa)`` and
``x_ics = R_ics_scs @ x_scs + lever_ics_m``. Default sigmas: Table 3.1 of the thesis.
"""

from pydantic import Field

from thalweg.config.base import Section
from thalweg.config.values import Angle, Sigma3, SigmaAngle, Vector3


class LidarMount(Section):
    """Scanner frame scs in the body frame: ``R_ics_scs = R_x(omega) R_y(phi) R_z(kappa)``."""

    omega_deg: Angle = Field(default=0.0, description="Rotation about x, degrees")
    phi_deg: Angle = Field(
        default=-90.0, description="Rotation about y, degrees (-90: spin axis points backwards)"
    )
    kappa_deg: Angle = Field(default=0.0, description="Rotation about z, degrees")
    lever_ics_m: Vector3 = Field(
        default=(0.0, 0.0, 0.0), description="Scanner origin in the body frame: forward, right, down, metres"
    )
    sigma_omega_deg: SigmaAngle = Field(default=0.018, description="Standard deviation of omega, degrees")
    sigma_phi_deg: SigmaAngle = Field(default=0.009, description="Standard deviation of phi, degrees")
    sigma_kappa_deg: SigmaAngle = Field(default=0.004, description="Standard deviation of kappa, degrees")
    sigma_lever_m: Sigma3 = Field(
        default=(0.0005, 0.0002, 0.0001), description="Standard deviations of the lever arm, metres"
    )


class Lever(Section):
    """A point sensor in the body frame."""

    lever_ics_m: Vector3 = Field(
        default=(0.0, 0.0, 0.0), description="Its place in the body frame: forward, right, down, metres"
    )
    sigma_lever_m: Sigma3 = Field(
        default=(0.005, 0.005, 0.005), description="Standard deviations of the lever arm, metres"
    )


class Mounts(Section):
    """Sensors in the body frame ics of the INS: x forward, y right, z down."""

    lidar: LidarMount = Field(default=LidarMount(), description="Scanner")
    antenna: Lever = Field(default=Lever(), description="Phase centre of the GNSS antenna")
    echo_sounder: Lever = Field(default=Lever(), description="Face of the echo sounder's transducer")
