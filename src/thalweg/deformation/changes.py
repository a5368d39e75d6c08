"""Two epochs of boats compared: registered distances with the errors that their points share."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
from scipy.stats import norm

from thalweg.core import ArrayB, ArrayF, column, frame_of, table_kind
from thalweg.deformation.compare import Comparison, Distances, distances_along, judge_changes
from thalweg.deformation.core_points import bank_line_m, lines_of_bank
from thalweg.deformation.coregistration import (
    PARAMETERS,
    Network,
    Registration,
    coregister,
    coregister_network,
    design_of,
)
from thalweg.deformation.drawn_ground import between_two, field_with, moved_apart, with_motion
from thalweg.deformation.epochs import Epoch, highest_water_m
from thalweg.deformation.field import ErrorField, joint_fields
from thalweg.deformation.m3c2 import ColumnIndex, Cylinders, cut_cylinders, mean_in_cylinders
from thalweg.deformation.series import Closure, closure
from thalweg.settings.sections import Deformation

YEAR_S = 365.25 * 86_400.0
"""A Julian year."""
N_DRAWS = 50
"""Draws of the errors that are handed on."""
DRAWS = table_kind(
    "error_draws",
    1,
    [
        column("core", "1", "number of the core point", pa.int64()),
        *(
            column(f"draw_{i:02d}_m", "m", "error of the registered distance in this draw")
            for i in range(N_DRAWS)
        ),
    ],
)
"""One row a core point: errors of all distances as they may be together, for products of one's own."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Pair:
    """Distances between two epochs before a registration, and all that their variance is made from.

    Attributes
    ----------
    cores : table `thalweg.deformation.core_points.CORE_POINTS`.
    epochs : both.
    found : distances.
    field : shared errors of the distances.
    white_m : (k,) standard deviation of the distances by noise and roughness of single points.
    scatter_m : (k, 2) standard deviation of the points along the normal in both epochs.
    several : (k, 2) share of points whose beam had more than one echo.
    """

    cores: pd.DataFrame
    epochs: tuple[Epoch, Epoch]
    found: Distances
    field: ErrorField
    white_m: ArrayF
    scatter_m: ArrayF
    several: ArrayF

    @property
    def bare(self) -> ArrayB:
        """Core points (k,) about which the points of both epochs scatter no more than bare ground does."""
        return is_bare(self.scatter_m)


def is_bare(scatter_m: ArrayF) -> ArrayB:
    """Core points (k,) whose points scatter (k, n) in no epoch more than those of bare ground do."""
    widest = np.max(scatter_m, axis=1)
    return np.asarray(widest <= 2.0 * np.nanmedian(widest))


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """Mean positions of one epoch along the normals of core points, and what errs in them.

    Attributes
    ----------
    epoch : the epoch.
    cut : what cylinders cut out.
    field : shared errors of the mean positions.
    own_m : (k,) standard deviation of the means by the predicted noise of single points.
    several : (k,) share of points whose beam had more than one echo.
    """

    epoch: Epoch
    cut: Cylinders
    field: ErrorField
    own_m: ArrayF
    several: ArrayF

    @property
    def white_m(self) -> ArrayF:
        """Standard deviation (k,) by noise: the larger of predicted and observed."""
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.fmax(self.own_m, self.cut.std_m / np.sqrt(self.cut.n)))


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Distances of epochs from the first, along the normals of core points.

    Attributes
    ----------
    years : (n,) times.
    height_m : (n, k) registered, zero in the first row; NaN where not seen. ``raw_m``: before registration.
    sigma_m : (n, k) standard deviation of each epoch's own registered mean.
    sigma_apart_m : (n - 1,) standard deviation of the mean distance of neighbouring epochs.
    network : registration of all epochs.
    misclosure : of changes from epoch to epoch against that from first to last, if each pair is registered by
        itself; in the network there is none.
    lines : of the bank in stretches, see `thalweg.deformation.core_points.lines_of_bank`.
    line_m, line_sigma_m : (n, q) their registered movement from the first epoch, and the standard deviation
        of each epoch's own.
    """

    years: ArrayF
    height_m: ArrayF
    sigma_m: ArrayF
    raw_m: ArrayF
    sigma_apart_m: ArrayF
    network: Network
    misclosure: Closure
    lines: pd.DataFrame
    line_m: ArrayF
    line_sigma_m: ArrayF


def measure_epoch(cores: pd.DataFrame, epoch: Epoch, settings: Deformation) -> Measured:
    """Mean positions of an epoch at core points; arguments as for `measure_pair`."""
    places, normals = _places(cores)
    how = {"radius_m": settings.cylinder_radius_m, "half_length_m": settings.reach_m}
    index = ColumnIndex.of(epoch.xyz_m, settings.cylinder_radius_m)
    cut = cut_cylinders(places, normals, index, **how, least=settings.least_in_cylinder)
    values = np.column_stack([epoch.white_m2, epoch.several_returns])
    means = mean_in_cylinders(places, normals, index, values, **how)
    e, n, u = normals.T
    along = np.stack([e * e, 2 * e * n, 2 * e * u, n * n, 2 * n * u, u * u], axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        own = np.sqrt(np.sum(along * means[:, :6], axis=1) / cut.n)
    field = epoch.field(places, normals, index, **how)
    return Measured(epoch=epoch, cut=cut, field=field, own_m=own, several=means[:, 6])


def _places(cores: pd.DataFrame) -> tuple[ArrayF, ArrayF]:
    """Core points and normals, (k, 3) each."""
    axes = ("east", "north", "up")
    return (cores[[f"{a}_m" for a in axes]].to_numpy(), cores[[f"normal_{a}" for a in axes]].to_numpy())


def measure_pair(cores: pd.DataFrame, before: Epoch, after: Epoch, settings: Deformation) -> Pair:
    """Distances from the first to the second epoch at core points, and what errs in them.

    Parameters
    ----------
    cores : table `thalweg.deformation.core_points.CORE_POINTS`.
    before, after : epochs in one frame.
    settings : cylinders, and whether the mounts are common.

    Raises
    ------
    GeometryError : no core point has points of both epochs.
    """
    one, two = (measure_epoch(cores, epoch, settings) for epoch in (before, after))
    return _pair(cores, one, two, settings)


def _pair(cores: pd.DataFrame, one: Measured, two: Measured, settings: Deformation) -> Pair:
    """A pair of two measured epochs."""
    places, normals = _places(cores)
    found = distances_along(places, normals, cores["scale_m"].to_numpy(), one.cut, two.cut)
    return Pair(
        cores=cores,
        epochs=(one.epoch, two.epoch),
        found=found,
        field=difference_of(one.field, two.field, common_mounts=settings.errors.common_mounts),
        white_m=np.hypot(one.white_m, two.white_m),
        scatter_m=np.column_stack([one.cut.std_m, two.cut.std_m]),
        several=np.column_stack([one.several, two.several]),
    )


def series_of_epochs(cores: pd.DataFrame, epochs: Sequence[Epoch], settings: Deformation) -> Series:
    """Registered distances of all epochs from the first, for `thalweg.deformation.series.fit_series`.

    All epochs are registered to each other in one adjustment
    (`thalweg.deformation.coregistration.coregister_network`): errors that an epoch has everywhere are taken
    off on ground that all of them agree on.
    """
    places, normals = _places(cores)
    every = [measure_epoch(cores, epoch, settings) for epoch in epochs]
    along = np.array([np.where(a.cut.n >= settings.least_in_cylinder, a.cut.along_m, np.nan) for a in every])
    white = np.array([alone.white_m for alone in every])
    along[~np.isfinite(white)] = np.nan
    scatter = np.array([alone.cut.std_m for alone in every])
    common = "mount" if settings.errors.common_mounts else None
    apart = None
    if not all(epoch.has_trajectory for epoch in epochs):
        apart = moved_apart(cores, epochs, settings, along, is_bare(scatter.T))
    fields = joint_fields(
        [
            alone.field if apart is None else field_with(alone.field, places, normals, apart.facts, 1)
            for alone in every
        ],
        common=common,
    )
    if apart is not None and apart.facts["model"] != "none":
        apart.facts.update(
            parameters=[dict(zip(PARAMETERS, each, strict=True)) for each in apart.parameters.tolist()],
            sigmas=[
                dict(zip(PARAMETERS, each, strict=True))
                for each in np.sqrt(np.maximum(np.diag(apart.cov), 0.0)).reshape(-1, 6).tolist()
            ],
        )
    network = (
        coregister_network(places, normals, along, white, is_bare(scatter.T), fields, settings)
        if apart is None
        else Network(
            apart.parameters,
            apart.cov,
            design_of(places, normals, places.mean(axis=0)),
            np.zeros((len(epochs), 6, *along.shape)),
            apart.stable,
            apart.facts,
        )
    )
    height = network.registered(along)
    raw = along - along[0]
    # how far two epochs may lie apart as such: the mean distance before any registration
    lying, steps = [], []
    for one, two in pairwise(every):
        pair = _pair(cores, one, two, settings)
        steps.append(register_pair(pair, settings).registered(pair.found.distance_m))
        use = np.isfinite(pair.found.distance_m)
        row = np.where(use, 1.0 / max(int(use.sum()), 1), 0.0)[None]
        lying.append(float(np.sqrt(pair.field.combined(row).variances()[0])))
    whole = _pair(cores, every[0], every[-1], settings)
    first_to_last = register_pair(whole, settings).registered(whole.found.distance_m)
    bare = is_bare(scatter.T) & np.isfinite(height).all(axis=0)
    water = highest_water_m(epochs)
    lines, products = lines_of_bank(cores, bare, settings, bank_line_m(settings, water))
    height = height - height[0]
    return Series(
        years=np.array([epoch.start_gps_s for epoch in epochs]) / YEAR_S,
        height_m=height,
        sigma_m=np.sqrt(network.variances(fields, white)),
        raw_m=raw,
        sigma_apart_m=np.array(lying),
        network=network,
        misclosure=closure(np.array(steps), first_to_last),
        lines=lines,
        line_m=np.nan_to_num(height) @ products.T,
        line_sigma_m=np.sqrt(network.variances(fields, white, products)),
    )


def difference_of(before: ErrorField, after: ErrorField, *, common_mounts: bool) -> ErrorField:
    """Errors of ``after - before``: those of both, but the errors of common mounts once, as a difference."""
    one, two = joint_fields([before, after], common="mount" if common_mounts else None)
    rows = tuple((b - a).sorted_indices() for a, b in zip(one.rows, two.rows, strict=True))
    return ErrorField(one.groups, rows)


def register_pair(pair: Pair, settings: Deformation) -> Registration:
    """The motion between both epochs.

    Of boats with their trajectories see `thalweg.deformation.coregistration.coregister`, of others
    `thalweg.deformation.drawn_ground`: what nobody drew as stable takes nothing off.
    """
    found = pair.found
    if not all(epoch.has_trajectory for epoch in pair.epochs):
        along = np.stack([np.where(np.isfinite(found.distance_m), 0.0, np.nan), found.distance_m])
        apart = moved_apart(pair.cores, pair.epochs, settings, along, pair.bare)
        parameters, cov, facts = between_two(apart)
        k = len(pair.cores)
        design = design_of(found.cores_m, found.normals, found.cores_m.mean(axis=0))
        return Registration(parameters, cov, design, np.zeros((6, k)), apart.stable, facts)
    return coregister(
        found.cores_m, found.normals, found.distance_m, pair.white_m, pair.bare, pair.field, settings
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """Registered distances with the parts of their variance.

    Attributes
    ----------
    pair, registration : what they come from.
    distance_m : (k,) registered; NaN where an epoch has too few points.
    sigma_field_m : (k,) by errors that points share, with what the registration takes off them.
    sigma_registration_m : (k,) by noise of the stable ground, or by the motion where it is known apart.
    """

    pair: Pair
    registration: Registration
    distance_m: ArrayF
    sigma_field_m: ArrayF
    sigma_registration_m: ArrayF

    @property
    def sigma_m(self) -> ArrayF:
        """Standard deviation (k,) of the registered distances."""
        return np.sqrt(self.sigma_field_m**2 + self.pair.white_m**2 + self.sigma_registration_m**2)

    def variances(self, products: ArrayF) -> tuple[ArrayF, ArrayF]:
        """Variances (q,) of weighted sums (q, k) of registered distances: by shared errors, and by noise."""
        sums = products - (products @ self.registration.design) @ self.registration.weights
        white = np.where(np.isfinite(self.pair.white_m), self.pair.white_m, 0.0)
        return self.pair.field.combined(sums).variances(), (sums**2) @ white**2

    def draws(self, n: int, seed: int) -> Iterator[ArrayF]:
        """Errors (k,) of the registered distances, drawn; NaN where unmeasured."""
        rng = np.random.default_rng(seed)
        white = self.pair.white_m
        for _ in range(n):
            error = self.pair.field.draw(rng) + white * rng.standard_normal(len(white))
            yield self.registration.of_errors(error)


def draw_errors(compared: Compared, seed: int) -> pd.DataFrame:
    """Table `DRAWS`: errors of registered distances, drawn from field and noise; NaN where unmeasured."""
    drawn = compared.draws(N_DRAWS, seed)
    known = np.isfinite(compared.distance_m)
    columns = {f"draw_{i:02d}_m": np.where(known, error, np.nan) for i, error in enumerate(drawn)}
    return frame_of(DRAWS, {"core": np.arange(len(compared.distance_m)), **columns})


def registered_distances(pair: Pair, registration: Registration) -> Compared:
    """Registered distances, and their variance with the registration's own weights.

    The variance of ``d - h'S d`` is ``var d - 2 h' cov(S d, d) + h' cov(S d) h``. A motion that is known
    apart from the distances has no ``S``, and its covariance is one more error of all of them.
    """
    S, design, found = registration.weights, registration.design, pair.found
    apart = 0.0
    if not S.any():
        field = field_with(pair.field, found.cores_m, found.normals, registration.facts, 2)
        pair = replace(pair, field=field)
        apart = np.einsum("ki,ij,kj->k", design, registration.cov, design)
    motion = pair.field.combined(S)
    with_all = pair.field.covariance_with(motion)
    own = motion.covariance_with(motion)
    field = pair.field.variances() - 2.0 * np.sum(design * with_all, axis=1)
    field += np.einsum("ki,ij,kj->k", design, own, design)
    white = np.nan_to_num(pair.white_m) ** 2
    noise = np.einsum("ki,ij,kj->k", design, (S * white) @ S.T, design)
    noise -= 2.0 * np.sum(design * S.T, axis=1) * white  # a stable core point's noise is in both
    if registration.cov.any() and not S.any():
        pair = replace(pair, field=with_motion(pair.field, design, registration.cov))
    return Compared(
        pair=pair,
        registration=registration,
        distance_m=registration.registered(found.distance_m),
        sigma_field_m=np.sqrt(np.maximum(field, 0.0)),
        sigma_registration_m=np.sqrt(np.maximum(noise, 0.0) + apart),
    )


def compare_epochs(
    cores: pd.DataFrame,
    before: Epoch,
    after: Epoch,
    registration: Registration,
    settings: Deformation,
    seed: int,
) -> tuple[pd.DataFrame, Compared, dict[str, Any]]:
    """Table `thalweg.deformation.compare.CHANGES` of two epochs, and facts about it.

    Parameters
    ----------
    cores : table `thalweg.deformation.core_points.CORE_POINTS`.
    before, after : epochs in one frame.
    registration : from `register_pair`.
    settings : see there.
    seed : of the draws for ``control: family``.

    Raises
    ------
    GeometryError : no core point has points of both epochs.
    """
    compared = registered_distances(measure_pair(cores, before, after, settings), registration)
    facts: dict[str, Any] = {"control": settings.control, "level": settings.level}
    limit = None
    if settings.control == "family":
        sigma = compared.sigma_m
        largest = [np.nanmax(np.abs(error) / sigma) for error in compared.draws(settings.draws, seed)]
        limit = float(np.quantile(largest, 1.0 - settings.level))
        facts["limit_of_normalised_distance"] = limit
    table = judge_changes(
        Distances(
            compared.pair.found.cores_m,
            compared.pair.found.normals,
            compared.pair.found.scale_m,
            compared.pair.found.n,
            compared.distance_m,
            compared.pair.white_m,
        ),
        Comparison(
            radius_m=settings.cylinder_radius_m,
            half_length_m=settings.reach_m,
            least_points=settings.least_in_cylinder,
            level=settings.level if limit is None else float(2.0 * norm.sf(limit)),
            control="fdr" if settings.control == "fdr" else "none",
        ),
        sigma_field_m=compared.sigma_field_m,
        sigma_white_m=compared.pair.white_m,
        sigma_registration_m=compared.sigma_registration_m,
    )
    return table, compared, facts
