"""What nearly all scripts import, loaded by the import of this module: jobs are forked from there (`forked`).

Nothing here may start a thread that it needs later: a fork has only the one that called. (The one of
pyarrow's allocator starts again by itself, and so do those of BLAS.)
"""

import contextlib
import gc
import os
from importlib import import_module
from typing import Final

LIBRARIES: Final = (
    "snakemake.cli",  # each fork wants the main module of its parent
    "PIL.ImageDraw",
    "cmcrameri.cm",
    "cv2",
    "laspy",
    "matplotlib.backends.backend_agg",
    "matplotlib.dates",
    "numba.typed",
    "numpy",
    "pandas",
    "pyarrow.dataset",
    "pyarrow.parquet",
    "pyproj",
    "scipy.interpolate",
    "scipy.ndimage",
    "scipy.optimize",
    "scipy.signal",
    "scipy.sparse.linalg",
    "scipy.spatial.transform",
    "scipy.stats",
    "thalweg.accuracy.comparison",
    "thalweg.core.camera",
    "thalweg.core.kernels",
    "thalweg.core.las",
    "thalweg.core.trajectory",
    "thalweg.ingest.integrity",
    "thalweg.lidar.cloud",
    "thalweg.settings.campaign",
    "thalweg.workflow.job",
)

os.environ["OPENBLAS_NUM_THREADS"] = "1"  # read when numpy and scipy load; as `run_job` sets it
for _name in LIBRARIES:
    with contextlib.suppress(ModuleNotFoundError):  # of an extra: said by the job that needs it
        import_module(_name)
# What numba would import when a job calls its first kernel.
import_module("numba.core.registry").cpu_target.target_context.refresh()
with contextlib.suppress(import_module("thalweg.core").ThalwegError):  # said by the job that needs it
    import_module("thalweg.core.geometry")._open3d()
gc.freeze()  # each search for garbage in a job would go through these libraries, 0.14 s
