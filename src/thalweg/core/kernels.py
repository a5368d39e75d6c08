"""Numba as the project uses it: which threads, and where machine code is kept between processes.

Modules with compiled functions take `njit` and `prange` from here, so that both are settled before the first
function is compiled. Numba's own cache takes a compiled function for good as long as its file is unchanged,
although constants and functions of other modules are frozen into the machine code. Here a function belongs to
a `stamp` of its file and of all that its module takes from others: kernels may be shared between modules, an
edit compiles again what it reaches and nothing else, and checkouts with equal kernels share one cache.
"""

import enum
import hashlib
import logging
import os
import shutil
import time
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import numba
import numpy as np
from numba import get_num_threads, prange, set_num_threads
from numba.core.caching import InTreeCacheLocator

from thalweg.core.errors import others_may_write
from thalweg.core.installed import PACKAGES

__all__ = ["KernelCache", "get_num_threads", "njit", "prange", "set_num_threads", "stamp"]

# Read when OpenMP loads, at the first parallel loop. By default threads that wait for the next loop spin:
# on a machine with other jobs, kriging in small blocks took five times its own time of the processor.
os.environ.setdefault("OMP_WAIT_POLICY", "passive")
# Open3D brings an old TBB into the process, which numba would try first and complain about.
numba.config.THREADING_LAYER_PRIORITY = ["omp", "workqueue", "tbb"]
numba.config.CACHE_LOCATOR_CLASSES = (
    "thalweg.core.kernels.KernelCache,UserProvidedCacheLocator,InTreeCacheLocator,UserWideCacheLocator,"
    "IPythonCacheLocator,ZipCacheLocator"
)

njit: Final = partial(numba.njit, no_cfunc_wrapper=True)
"""That of numba, without the second entry for callers in C, which would be a tenth of the compiling."""

log = logging.getLogger(__name__)
_KEPT_DAYS: Final = 30.0
"""Folders that no process has used for so long are removed."""
_folders: Final[dict[str, str]] = {}
"""Of each module: the stamp of a function covers the constants above it, the first one names the folder."""


def stamp(namespace: Mapping[str, Any], _seen: frozenset[str] = frozenset()) -> str:
    """Hash of what the machine code of a module's functions depends on.

    Parameters
    ----------
    namespace : globals of the module, as they are where a function is defined: what it takes from other
        modules has been imported by then.

    Returns
    -------
    stamp : hash of the module's file, of its constants (numbers, texts, tuples, arrays, enumerations), and of
        the modules whose compiled functions it takes, directly or through others.
    """
    digest = hashlib.sha256(Path(namespace["__file__"]).read_bytes())
    seen = _seen | {namespace["__name__"]}
    for name, value in sorted(namespace.items()):
        taken = _namespace_of(value)
        if taken is not None:
            text = "" if taken["__name__"] in seen else stamp(taken, seen)
        else:
            text = "" if name.startswith("__") else _constant(value)
        digest.update(f"{name} {text}".encode() if text else b"")
    return digest.hexdigest()


def _constant(value: Any) -> str:
    """A value that machine code can hold, as text that is the same in each process; empty for all others."""
    if isinstance(value, np.ndarray) and value.dtype != object:
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, enum.EnumMeta):
        return str([_constant(member.value) for member in value])  # type: ignore[var-annotated]
    if isinstance(value, tuple):
        return str([_constant(each) for each in value])
    return repr(value) if isinstance(value, bool | int | float | complex | str | np.generic) else ""


def _namespace_of(value: Any) -> Mapping[str, Any] | None:
    """Globals of the project's module that a compiled function comes from, or that the value is itself."""
    if isinstance(value, ModuleType):
        found: Mapping[str, Any] = vars(value)
    elif hasattr(value, "py_func"):
        found = value.py_func.__globals__
    else:
        return None
    return found if found["__name__"].split(".")[0] in PACKAGES else None


class KernelCache(InTreeCacheLocator):
    """Tells numba where the machine code of a function of the project is kept, and what it belongs to.

    The folder is ``<user's cache>/thalweg/kernels/<module>-<stamp>``; beside the module where the user has no
    cache that can be written. ``NUMBA_CACHE_DIR`` takes the place of the user's cache. A folder into which
    others may write is not used: what they put there would run here.
    """

    def __init__(self, py_func: Any, py_file: str) -> None:
        super().__init__(py_func, py_file)
        self._stamp = stamp(py_func.__globals__)

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> "KernelCache | None":
        """A locator for a function of the project; None for others, and where no folder can be written."""
        if py_func.__module__.split(".")[0] not in PACKAGES:
            return None
        self = cls(py_func, py_file)
        for base in _kernels_folders(Path(py_file).parent):
            path = base / _folders.setdefault(py_func.__module__, f"{py_func.__module__}-{self._stamp[:16]}")
            self._cache_path = os.fspath(path)
            try:
                is_new = not path.is_dir()
                self.ensure_cache_path()
                os.utime(path)
                if is_new:
                    _forget_old(base)
            except OSError:
                continue
            return self
        return None

    def get_source_stamp(self) -> str:
        """The stamp of the module: numba compiles again where it differs from the one of the machine code."""
        return self._stamp


def _kernels_folders(beside: Path) -> list[Path]:
    """Where machine code may be kept, the best first; none into which others could put theirs."""
    own = os.environ.get("NUMBA_CACHE_DIR")
    base = Path(own or os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache")
    folders = [base / "thalweg" / "kernels", beside / "__pycache__"]
    if shared := [each for each in folders if others_may_write(each)]:
        _tell_shared(shared[0])
    return [each for each in folders if each not in shared]


@cache
def _tell_shared(folder: Path) -> None:
    numba.config.CACHE_DIR = ""  # numba itself would take it next
    log.warning(
        "machine code is not kept in %s, into which others may write; expected a folder of one's own. Take"
        " the right to write from others (chmod go-w), or set NUMBA_CACHE_DIR to another folder.",
        folder,
    )


def _forget_old(base: Path) -> None:
    for folder in base.glob("thalweg*-*"):
        if time.time() - folder.stat().st_mtime > _KEPT_DAYS * 86_400:
            shutil.rmtree(folder, ignore_errors=True)
