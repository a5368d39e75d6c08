"""Section ``mounts``: where the sensors sit in the body frame of the INS.

Body frame ics: x forward, y right, z down. ``R_ics_scs = R_x(omega) R_y(phi) R_z(kappa)`` and
``x_ics = R_ics_scs @ x_scs + lever_ics_m``. Default sigmas: Table 3.1 of the thesis.
"""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from thalweg.settings.sections.base import Angle, Section, Sigma3, SigmaAngle, Vector3

Correlation = Annotated[float, Field(ge=-1, le=1, allow_inf_nan=False)]
Row6 = tuple[Correlation, Correlation, Correlation, Correlation, Correlation, Correlation]


def is_calibration_path(text: str) -> bool:
    """True if ``mounts.calibration`` names a file, not a campaign: ids hold neither slash nor point."""
    return "/" in text or "." in text


class OrientedMount(Section):
    """A sensor that looks somewhere: ``R_ics_sensor = R_x(omega) R_y(phi) R_z(kappa)`` and its origin."""

    omega_deg: Angle = Field(default=0.0, description="Rotation about x, degrees")
    phi_deg: Angle = Field(default=0.0, description="Rotation about y, degrees")
    kappa_deg: Angle = Field(default=0.0, description="Rotation about z, degrees")
    lever_ics_m: Vector3 = Field(
        default=(0.0, 0.0, 0.0), description="Its origin in the body frame: forward, right, down, metres"
    )
    sigma_omega_deg: SigmaAngle = Field(default=0.018, description="Standard deviation of omega, degrees")
    sigma_phi_deg: SigmaAngle = Field(default=0.009, description="Standard deviation of phi, degrees")
    sigma_kappa_deg: SigmaAngle = Field(default=0.004, description="Standard deviation of kappa, degrees")
    sigma_lever_m: Sigma3 = Field(
        default=(0.0005, 0.0002, 0.0001), description="Standard deviations of the lever arm, metres"
    )
    sigma_axes: Literal["angles", "ics"] = Field(
        default="angles",
        description="What the sigmas of the angles are of: omega, phi, kappa themselves (`angles`), or small "
        "rotations about the axes x, y, z of the body (`ics`), as calibrations state them; at phi = -90 "
        "degrees only these describe every error",
    )
    correlation: tuple[Row6, Row6, Row6, Row6, Row6, Row6] | None = Field(
        default=None,
        description="Correlation matrix of omega, phi, kappa (or rotations about x, y, z), x, y, z from the "
        "calibration; null: uncorrelated",
    )

    @model_validator(mode="after")
    def _correlation_is_one(self) -> Self:
        if self.correlation is not None:
            import numpy as np  # here: every job imports this module, few of them have correlations

            matrix = np.asarray(self.correlation)
            # 1e-6: matrices are written with six digits or more.
            like = np.allclose(matrix, matrix.T, atol=1e-6)
            if (
                not like
                or not np.allclose(np.diag(matrix), 1.0, atol=1e-6)
                or np.linalg.eigvalsh(matrix)[0] < -1e-6
            ):
                raise ValueError(
                    "no correlation matrix: it must be symmetric, with ones in the diagonal, and without "
                    "negative eigenvalues"
                )
        return self


class LidarMount(OrientedMount):
    """Scanner frame scs in the body frame: ``R_ics_scs = R_x(omega) R_y(phi) R_z(kappa)``."""

    phi_deg: Angle = Field(
        default=-90.0, description="Rotation about y, degrees (-90: spin axis points backwards)"
    )


class CameraMount(OrientedMount):
    """Camera frame ccs (x right, y down, z view) in the body frame; 90, 0, 0 looks to port."""

    omega_deg: Angle = Field(default=90.0, description="Rotation about x, degrees (90: view to port)")
    sigma_omega_deg: SigmaAngle = Field(default=1.0, description="Standard deviation of omega, degrees")
    sigma_phi_deg: SigmaAngle = Field(default=1.0, description="Standard deviation of phi, degrees")
    sigma_kappa_deg: SigmaAngle = Field(default=1.0, description="Standard deviation of kappa, degrees")
    sigma_lever_m: Sigma3 = Field(
        default=(0.01, 0.01, 0.01), description="Standard deviations of the lever arm, metres"
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

    calibration: Annotated[str, Field(min_length=1)] | None = Field(
        default=None,
        description="Id of a calibration campaign, or path to a calibration file (YAML): its sensors replace "
        "the values below, with their covariances",
    )
    lidar: LidarMount = Field(default=LidarMount(), description="Scanner")
    camera: CameraMount = Field(default=CameraMount(), description="Camera on the boat")
    antenna: Lever = Field(default=Lever(), description="Phase centre of the GNSS antenna")
    echo_sounder: Lever = Field(default=Lever(), description="Face of the echo sounder's transducer")
