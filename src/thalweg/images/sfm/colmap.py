"""The one door to COLMAP's Python module: quiet, seeded, loaded when it is needed.

Whatever draws random numbers in COLMAP does so from a generator of the calling thread or from a seed in its
options. `colmap` sets the first back to a fixed seed each time it is called, and the callers set the second,
so that no result depends on what ran before in the same process.
"""

from typing import Any, Final

from thalweg.core.errors import InputError

SEED: Final = 0
"""Of all random choices inside COLMAP: samples of RANSAC, starts of the global mapper."""


def colmap() -> Any:
    """The module ``pycolmap``, its log reduced to fatal errors and its generator set to `SEED`.

    COLMAP's log writes lines for every image; what matters of them is found and said by the callers.

    Raises
    ------
    InputError : the module cannot be loaded.
    """
    try:
        import pycolmap
    except ImportError as error:
        raise InputError(
            f"COLMAP cannot be loaded ({error})",
            expected="the package pycolmap",
            cure="Install the locked environment again",
        ) from error
    pycolmap.logging.minloglevel = int(pycolmap.logging.Level.FATAL)
    pycolmap.set_random_seed(SEED)
    return pycolmap
