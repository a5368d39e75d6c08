"""Structure from motion: features of images, pairs of images, and how they are put together."""

from typing import Annotated, Literal

from pydantic import Field

from thalweg.settings.base.base import Section
from thalweg.settings.base.values import Positive


class Features(Section):
    """Points that are found again in other images (SIFT)."""

    max_size_px: Annotated[int, Field(ge=160, le=20_000)] = Field(
        default=3200,
        description="Longest side in which features are looked for, pixels; larger images are scaled down. "
        "Time and memory grow with its square",
    )
    max_features: Annotated[int, Field(ge=100, le=100_000)] = Field(
        default=8192, description="Features kept of an image at most, those of the largest scale"
    )
    peak_threshold: Annotated[float, Field(gt=0, le=0.1)] = Field(
        default=0.0067,
        description="Least contrast of a feature, share of the full range; lower: more, weaker",
    )
    double_size: bool = Field(
        default=True,
        description="Look for features in the image at twice its size, too: more small features, four times "
        "the time and memory",
    )
    min_features: Annotated[int, Field(ge=8, le=10_000)] = Field(
        default=50, description="An image with fewer features takes no part"
    )
    parts: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=1,
        description="Jobs among which the images are dealt out; the result is the same for any number",
    )


class Mapping(Section):
    """Pairs of images, their common points, and the block that follows from them."""

    cameras: Literal["auto", "folder", "exif", "size"] = Field(
        default="auto",
        description="Which images one camera took, with an interior orientation of its own: `folder`: those "
        "of one folder; `exif`: those for which EXIF states the same maker, model, serial number and focal "
        "length; `auto`: those of which both is true, where images of one serial number may lie in several "
        "folders; `size`: all. Pictures of another size are of another camera in any case",
    )
    pairs: Literal["auto", "sequential", "spatial", "exhaustive"] = Field(
        default="auto",
        description="Images that are compared: `sequential`: neighbours in time; `spatial`: neighbours in "
        "time and by approximate position; `exhaustive`: all with all; `auto`: exhaustive up to "
        "`exhaustive_up_to` images, else sequential, and spatial where positions are given",
    )
    exhaustive_up_to: Annotated[int, Field(ge=2, le=2000)] = Field(
        default=30, description="Number of images up to which `auto` compares all with all"
    )
    overlap: Annotated[int, Field(ge=1, le=200)] = Field(
        default=10, description="Following images that an image is compared with"
    )
    quadratic: bool = Field(
        default=True,
        description="Compare with the images 2, 4, 8 ... places further as well, `overlap` of them at most",
    )
    max_distance_m: Positive = Field(
        default=15.0, description="Approximate distance up to which images are neighbours in space, metres"
    )
    max_neighbours: Annotated[int, Field(ge=1, le=500)] = Field(
        default=20, description="Neighbours in space that an image is compared with at most"
    )
    parts: Annotated[int, Field(ge=1, le=1000)] = Field(
        default=1,
        description="Jobs among which the pairs are dealt out; the result is the same for any number",
    )
    min_inliers: Annotated[int, Field(ge=8, le=1000)] = Field(
        default=15, description="Common points that a pair of images must have"
    )
    max_ratio: Annotated[float, Field(gt=0, lt=1)] = Field(
        default=0.8,
        description="Distance of the best over the second best match above which a match is ambiguous",
    )
    method: Literal["incremental", "global"] = Field(
        default="incremental",
        description="`incremental`: image by image; `global`: all at once, faster for large blocks, less "
        "patient with weak ones",
    )
    interior: Literal["auto", "estimated", "fixed"] = Field(
        default="auto",
        description="Whether focal length and distortion are estimated from the images or stay as they are "
        "given; the principal point stays in any case; `auto`: a given camera stays, and the adjustment with "
        "control points estimates it, another is estimated here. One strip along a bank hardly determines it",
    )
    lens: Literal["auto", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE"] = Field(
        default="auto",
        description="Model of the lens, in COLMAP's names; `auto`: that of the given camera, SIMPLE_RADIAL "
        "without one",
    )
    smallest_piece: Annotated[int, Field(ge=2, le=100)] = Field(
        default=3, description="Images that a separate piece of the block must have to be kept"
    )
    max_error_px: Positive = Field(
        default=2.0,
        description="Residual above which a mark is dropped, pixels of the image as it was searched",
    )
    sigma_px: Annotated[float, Field(gt=0, le=20)] = Field(
        default=0.4,
        description="Standard deviation of a mark of a feature of middle scale, pixels of the image as it "
        "was searched; larger features have more, as their residuals show",
    )
    repeatable: bool = Field(
        default=True,
        description="Put together by one thread, so that the same images give the same block bit by bit; "
        "false: with all threads, and frame and points may differ from run to run",
    )
