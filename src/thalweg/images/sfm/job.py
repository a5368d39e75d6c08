"""The matching of a campaign's images: from its files to the plan that all parts share."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thalweg.calibration.markers.camera_file import read_camera
from thalweg.core.trajectory import Trajectory
from thalweg.images.sfm.features import Features, join_features
from thalweg.images.sfm.matching import Matches
from thalweg.images.sfm.start import Known, plan_matches, read_times
from thalweg.ingest.photos.files import named_images


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchInputs:
    """Files of a campaign: features in parts, images, and what is known beforehand, each possibly absent.

    ``interiors`` are those of the cameras of folders, by the folder's name.
    """

    features: Sequence[Path]
    images: Sequence[Path]
    camera: Sequence[Path] = ()
    interiors: Mapping[str, Path] = field(default_factory=dict)
    times: Sequence[Path] = ()
    trajectory: Sequence[Path] = ()


def plan_of(
    inputs: MatchInputs, section: Mapping[str, Any], *, descriptors: bool = True
) -> tuple[Matches, NDArray[np.uint8]]:
    """Pairs of images to compare, and the descriptors (n, 128) of all features.

    Parameters
    ----------
    inputs : the files.
    section : section ``images.mapping`` of a campaign file.
    descriptors : false: none are read, they take most of the memory.

    Raises
    ------
    InputError : a file that cannot be used; else as of `plan_matches`.
    """
    features = join_features([Features.read(path, descriptors=descriptors) for path in inputs.features])
    known = Known(
        cameras=tuple(read_camera(path) for path in inputs.camera),
        of_folder={folder: read_camera(path) for folder, path in inputs.interiors.items()},
        t_s=read_times(inputs.times[0]) if inputs.times else {},
        trajectory=Trajectory.read(inputs.trajectory[0]) if inputs.trajectory else None,
    )
    plan = plan_matches(features, named_images(list(inputs.images)), known=known, section=section)
    return plan, features.descriptor
