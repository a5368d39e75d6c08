"""Options of a PPK run, and the configuration text of the engine made from them."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any, Final, Literal, Self

import numpy as np

from thalweg.core import ArrayF, ConfigError, LocalFrame
from thalweg.ingest.ppk.residuals import CODE_RATIO, PHASE_M
from thalweg.settings.sections import Ppk

SYSTEM_BITS: Final[Mapping[str, int]] = {"GPS": 1, "SBS": 2, "GLO": 4, "GAL": 8, "QZS": 16, "BDS": 32}
"""Values of RTKLIB's ``pos1-navsys`` (RTKLIB manual 2.4.2, section 3.5); their sum selects systems."""

AUTO_SYSTEMS: Final = ("GPS", "GAL", "QZS")
"""GLONASS needs receivers of one make, and of BeiDou no recording shows that it helps."""

EARTH_RADII_M: Final = (6_330_000.0, 6_400_000.0)
"""A base lies between the poles less 27 km and the equator plus 22 km."""

Frequencies = Literal["l1", "l1+l2", "l1+l2+l5", "l1+l2+l5+l6"]
Ambiguity = Literal["off", "continuous", "fix-and-hold", "instantaneous"]
Direction = Literal["forward", "backward", "combined"]
BaseSource = Literal["from_sbp", "rinex_header"]

_CHOICES: Final[dict[str, tuple[str, ...]]] = {
    "frequencies": ("l1", "l1+l2", "l1+l2+l5", "l1+l2+l5+l6"),
    "ambiguity": ("off", "continuous", "fix-and-hold", "instantaneous"),
    "direction": ("forward", "backward", "combined"),
    "iono": ("off", "brdc", "dual-freq", "est-stec"),
    "tropo": ("off", "saas", "est-ztd", "est-ztdgrad"),
}


_SECTION: Final = Ppk()


@dataclass(frozen=True, slots=True, kw_only=True)
class PpkOptions:
    """Options of `run_ppk`. The position of the base has no default: exactly one source must be named.

    Parameters
    ----------
    base_ecef_m : earth-centred position of the base antenna in metres, in the frame the result shall have.
    base_llh : the same as geodetic latitude (deg), longitude (deg) and ellipsoidal height (m).
    base_source : ``"from_sbp"`` takes MsgBasePosECEF or MsgBasePosLLH of the SBP log, ``"rinex_header"`` the
        APPROX POSITION of the base file with its antenna offset (often metres off: a note of the result
        says so).
    base_antenna_delta_enu_m : from the given base position to the antenna reference point, east, north, up.
    elevation_mask_deg : satellites below are not used.
    frequencies : ``"l1"``, ``"l1+l2"``, ``"l1+l2+l5"`` or ``"l1+l2+l5+l6"``; Galileo's E5b counts as l2 here.
    systems : of "GPS", "GLO", "GAL", "QZS", "BDS", "SBS"; "auto" takes those of `AUTO_SYSTEMS` that both logs
        hold.
    ambiguity : ``"continuous"`` or ``"fix-and-hold"``. ``"instantaneous"`` forgets the ambiguities at every
        epoch; this engine then fixed nothing on either of two real recordings where ``"continuous"`` fixes
        95 %. ``"off"`` leaves them float.
    fix_glonass, fix_beidou : resolve the ambiguities of these systems too. GLONASS needs receivers of the
        same make (inter-frequency biases).
    direction : ``"combined"`` weights a forward and a backward filter; the two share the observations.
    ratio_threshold : least ratio of the second-best to the best integer set for a fix.
    iono, tropo : atmosphere models, in RTKLIB's words.
    dynamics : True estimates velocity and acceleration too. False starts each epoch anew, and lost digits
        make the engine's covariances noisy (`thalweg.ingest.ppk.trust.replace_covariances`).
    max_age_s : base observations older than that are not used.
    trusted_baseline_km, least_fix_s : see `thalweg.ingest.ppk.trust`.

    Raises
    ------
    ConfigError : naming all options that are wrong.
    """

    base_ecef_m: tuple[float, float, float] | None = None
    base_llh: tuple[float, float, float] | None = None
    base_source: BaseSource | None = None
    base_antenna_delta_enu_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    elevation_mask_deg: float = _SECTION.elevation_mask_deg
    frequencies: Frequencies = _SECTION.frequencies
    systems: tuple[str, ...] | Literal["auto"] = _SECTION.systems
    ambiguity: Ambiguity = _SECTION.ambiguity
    fix_glonass: bool = _SECTION.fix_glonass
    fix_beidou: bool = _SECTION.fix_beidou
    direction: Direction = _SECTION.direction
    ratio_threshold: float = _SECTION.ratio_threshold
    iono: Literal["off", "brdc", "dual-freq", "est-stec"] = _SECTION.iono
    tropo: Literal["off", "saas", "est-ztd", "est-ztdgrad"] = _SECTION.tropo
    dynamics: bool = _SECTION.dynamics
    max_age_s: float = _SECTION.max_age_s
    trusted_baseline_km: float = _SECTION.trusted_baseline_km
    least_fix_s: float = _SECTION.least_fix_s

    def __post_init__(self) -> None:
        """Check all options at once."""
        wrong = [
            f"{name} is {getattr(self, name)!r}, not one of {', '.join(allowed)}"
            for name, allowed in _CHOICES.items()
            if getattr(self, name) not in allowed
        ]
        wrong += self._wrong_base()
        auto = self.systems == "auto"
        unknown = [s for s in self.systems if s not in SYSTEM_BITS]
        if not auto and (unknown or not self.systems or isinstance(self.systems, str)):
            wrong.append(f"systems is {self.systems!r}, not a list of {', '.join(SYSTEM_BITS)}")
        if not 0.0 <= self.elevation_mask_deg < 90.0:
            wrong.append(f"elevation_mask_deg is {self.elevation_mask_deg}, not in [0, 90)")
        if not 1.0 <= self.ratio_threshold < 1000.0:
            wrong.append(f"ratio_threshold is {self.ratio_threshold}, not in [1, 1000)")
        if not 0.0 < self.max_age_s <= 3600.0:
            wrong.append(f"max_age_s is {self.max_age_s}, not in (0, 3600]")
        if self.frequencies == "l1" and self.iono == "dual-freq":
            wrong.append("iono dual-freq needs two frequencies, but frequencies is 'l1'")
        if wrong:
            raise ConfigError(
                "wrong PPK options: " + "; ".join(wrong), cure="Correct these options; see PpkOptions"
            )
        if not auto:
            object.__setattr__(self, "systems", tuple(self.systems))

    def _wrong_base(self) -> list[str]:
        given = [n for n in ("base_ecef_m", "base_llh", "base_source") if getattr(self, n) is not None]
        if len(given) != 1:
            return [
                f"the base position is given by {' and '.join(given) or 'nothing'}: exactly one of "
                "base_ecef_m, base_llh, base_source='from_sbp' or base_source='rinex_header' is needed"
            ]
        if self.base_source is not None and self.base_source not in ("from_sbp", "rinex_header"):
            return [f"base_source is {self.base_source!r}, not one of from_sbp, rinex_header"]
        if len(self.base_antenna_delta_enu_m) != 3 or not np.all(np.isfinite(self.base_antenna_delta_enu_m)):
            return [f"base_antenna_delta_enu_m is {self.base_antenna_delta_enu_m}, not three finite metres"]
        if self.base_llh is not None:
            lat, lon, h = self.base_llh if len(self.base_llh) == 3 else (np.nan, np.nan, np.nan)
            if not (abs(lat) <= 90.0 and abs(lon) <= 360.0 and -1000.0 < h < 10_000.0):
                return [f"base_llh is {self.base_llh}, not latitude (deg), longitude (deg), height (m)"]
            if lat == lon == h == 0.0:
                return ["base_llh is all zero: that is an unset position"]
        if self.base_ecef_m is not None:
            fault = ecef_fault(np.asarray(self.base_ecef_m, dtype=np.float64))
            return [f"base_ecef_m {fault}"] if fault else []
        return []

    @classmethod
    def from_sections(cls, ppk: Mapping[str, Any], base_position: Mapping[str, Any]) -> Self:
        """Options from the sections ``ppk`` and ``logs.gnss`` of a campaign file.

        Parameters
        ----------
        ppk : options of this class by name.
        base_position : base_ecef_m, base_llh (three numbers, or lat_deg, lon_deg, h_ell_m), base_from
            (``sbp`` or ``rinex_header``) and base_antenna_delta_enu_m; keys that are None count as absent.

        Raises
        ------
        ConfigError : a key is unknown, or an option is wrong.
        """
        given: dict[str, Any] = {
            key: value for key, value in {**ppk, **base_position}.items() if value is not None
        }
        if "base_from" in given:
            source = given.pop("base_from")
            given["base_source"] = "from_sbp" if source == "sbp" else source
        llh = given.get("base_llh")
        if isinstance(llh, Mapping):
            given["base_llh"] = tuple(llh.get(key, np.nan) for key in ("lat_deg", "lon_deg", "h_ell_m"))
        known = {f.name for f in fields(cls)}
        unknown = sorted(set(given) - known)
        if unknown:
            raise ConfigError(f"unknown PPK options: {', '.join(unknown)}", expected=", ".join(sorted(known)))
        options: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in given.items()}
        return cls(**options)

    @property
    def explicit_base_ecef_m(self) -> ArrayF | None:
        """Base position of ``base_ecef_m`` or ``base_llh`` in earth-centred metres, shape (3,)."""
        if self.base_ecef_m is not None:
            return np.asarray(self.base_ecef_m, dtype=np.float64)
        if self.base_llh is None:
            return None
        lat, lon, h = self.base_llh
        return LocalFrame(lat_deg=lat, lon_deg=lon, h_ell_m=h).origin_ecef_m

    def plain(self) -> dict[str, Any]:
        """The options as JSON-able values."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in asdict(self).items()}


def ecef_fault(xyz_ecef_m: ArrayF) -> str:
    """Why earth-centred coordinates cannot be a base on the ground; "" if they can."""
    if xyz_ecef_m.shape != (3,) or not np.all(np.isfinite(xyz_ecef_m)):
        return "is not three finite numbers"
    radius = float(np.linalg.norm(xyz_ecef_m))
    if radius == 0.0:
        return "is all zero: that is an unset position"
    if not EARTH_RADII_M[0] < radius < EARTH_RADII_M[1]:
        return f"lies {radius / 1000.0:.1f} km from the centre of the earth: no place on the ground"
    return ""


def engine_settings(options: PpkOptions, base_ecef_m: ArrayF, *, single: bool = False) -> dict[str, str]:
    """Settings of RTKLIB (names and words of its option file) for a PPK or a single-point run.

    ``navsys`` is a number because words fall through a switch in some builds; the base position is always
    explicit because the default is the mean of single positions, metres off.
    """
    on = {True: "on", False: "off"}
    return {
        "pos1-posmode": "single" if single else "kinematic",
        "pos1-frequency": options.frequencies,
        "pos1-soltype": "forward" if single else options.direction,
        "pos1-elmask": f"{options.elevation_mask_deg:.10g}",
        "pos1-dynamics": on[options.dynamics and not single],
        "pos1-ionoopt": "brdc" if single else options.iono,
        "pos1-tropopt": "saas" if single else options.tropo,
        "pos1-sateph": "brdc",
        "pos1-navsys": str(sum(SYSTEM_BITS[s] for s in set(options.systems))),
        "pos2-armode": options.ambiguity,
        "pos2-gloarmode": on[options.fix_glonass],
        "pos2-bdsarmode": on[options.fix_beidou],
        "pos2-arthres": f"{options.ratio_threshold:.10g}",
        "pos2-arthresmin": f"{options.ratio_threshold:.10g}",
        "pos2-arthresmax": f"{options.ratio_threshold:.10g}",
        "pos2-maxage": f"{options.max_age_s:.10g}",
        # what the engine takes as noise, so that its residuals tell how large it is
        "stats-errphase": f"{PHASE_M:g}",
        "stats-errphaseel": f"{PHASE_M:g}",
        **{f"stats-eratio{k}": f"{CODE_RATIO:g}" for k in (1, 2, 5, 6)},
        "out-outstat": "off" if single else "residual",
        "out-solformat": "llh",
        "out-outhead": "on",
        "out-outopt": "on",
        "out-outsingle": "on",
        "out-timesys": "gpst",
        "out-timeform": "tow",
        "out-timendec": "6",
        "out-degform": "deg",
        "out-height": "ellipsoidal",
        "ant2-postype": "xyz",
        **{f"ant2-pos{k + 1}": f"{base_ecef_m[k]:.6f}" for k in range(3)},
    }
