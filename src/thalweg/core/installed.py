"""What is installed: where the files beside the library lie, and which extra brings an absent package."""

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from thalweg.core.errors import UnsupportedError

PACKAGED: Final = Path(__file__).resolve().parents[1] / "workflow_files"
ROOT: Final = PACKAGED if PACKAGED.is_dir() else PACKAGED.parents[2]
"""Folder with Snakefile, workflow, config, resources and profiles: in the wheel, or the repository."""

PACKAGES: Final = {"thalweg", "thalweg_lab"}
"""The project's own."""
EXTRAS: Final = {
    "cv2": "images",
    "pycolmap": "images",
    "open3d": "mesh",
    "libusb_package": "mesh",
    "pyrtklib5": "gnss",
    "pye57": "e57",
    "typst": "report",
    "pymavlink": "ardupilot",
    "rosbags": "ros",
    "pyubx2": "ubx",
    "telemetry_parser": "gopro",
    "ouster": "ouster",
}
"""Extra of pyproject.toml that brings a module; what is not here comes with Thalweg itself."""

PRODUCTS: Final = {
    "images": "work with images",
    "mesh": "casting rays on a mesh",
    "gnss": "post-processed GNSS",
    "e57": "an E57 cloud",
    "report": "a report as PDF",
    "ardupilot": "a log of an ArduPilot autopilot",
    "ros": "a bag of ROS",
    "ubx": "a UBX log",
    "gopro": "the track of a GoPro video",
    "ouster": "a recording of an Ouster",
}
"""What an extra is for, in the words of a refusal."""


def missing_package(error: ImportError, where: str | Path = "") -> Exception:
    """The refusal of a product whose package is not installed.

    Parameters
    ----------
    error : what an import raised.
    where : the file that asked for it, if there is one.

    Returns
    -------
    Exception
        An `UnsupportedError` that names the extra; the error itself where no extra brings the module.

    Examples
    --------
    >>> print(missing_package(ModuleNotFoundError(name="pye57")))
    an E57 cloud needs the package pye57, which is not installed; expected the extra 'e57' of thalweg. ...
    """
    name = (error.name or "").partition(".")[0]
    if name not in EXTRAS:
        return error
    return UnsupportedError(
        f"{PRODUCTS[EXTRAS[name]]} needs the package {name}, which "
        + ("is not installed" if isinstance(error, ModuleNotFoundError) else f"cannot be loaded ({error})"),
        expected=f"the extra '{EXTRAS[name]}' of thalweg",
        where=where,
        cure=f'Run: {sys.executable} -m pip install "thalweg[{EXTRAS[name]}]"',
    )


class _Optional(ModuleType):
    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):  # what tools ask of every module
            raise AttributeError(name)
        try:
            return getattr(import_module(self.__name__), name)
        except ImportError as error:
            raise missing_package(error) from error


def optional(name: str) -> Any:
    """A module of an extra, in place of its import: loaded by its first use, which `missing_package` refuses.

    Parameters
    ----------
    name : of the module, a key of `EXTRAS`.

    Examples
    --------
    >>> optional("cv2").BORDER_CONSTANT
    0
    """
    return _Optional(name)
