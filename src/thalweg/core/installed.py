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


def missing_package(error: ImportError, product: str = "this", where: str | Path = "") -> Exception:
    """The refusal of a product whose package is not installed.

    Parameters
    ----------
    error : what an import raised.
    product : what was asked for, such as ``a bag of ROS``.
    where : the file that asked for it, if there is one.

    Returns
    -------
    Exception
        An `UnsupportedError` that names the extra; the error itself where no extra brings the module.

    Examples
    --------
    >>> print(missing_package(ModuleNotFoundError(name="cv2"), "a board"))
    a board needs the package cv2, which is not installed; expected the extra 'images' of thalweg. ...
    """
    name = (error.name or "").partition(".")[0]
    if name not in EXTRAS:
        return error
    return UnsupportedError(
        f"{product} needs the package {name}, which "
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
