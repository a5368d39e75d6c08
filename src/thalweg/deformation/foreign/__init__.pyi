from .clouds import (
    DISTANCES as DISTANCES,
    TEXT as TEXT,
    compare_clouds as compare_clouds,
    compare_files as compare_files,
    compare_nearest as compare_nearest,
    compare_with_surface as compare_with_surface,
    point_spacing_m as point_spacing_m,
    read_points as read_points,
    sigma_of_mean as sigma_of_mean,
    write_changes as write_changes,
)
from .differences import (
    difference_of_epochs as difference_of_epochs,
    difference_of_models as difference_of_models,
)
from .epochs import (
    ForeignEpoch as ForeignEpoch,
    check_epoch_files as check_epoch_files,
    dsm_of as dsm_of,
    notes_of_pair as notes_of_pair,
    place_of_file as place_of_file,
    prepare_foreign_epoch as prepare_foreign_epoch,
    read_epoch as read_epoch,
    with_drawn_areas as with_drawn_areas,
)
from .surfaces import (
    HeightErrors as HeightErrors,
    SurfaceDifference as SurfaceDifference,
    difference_of_surfaces as difference_of_surfaces,
    difference_on_lines as difference_on_lines,
    onto_grid as onto_grid,
    read_difference as read_difference,
    write_difference as write_difference,
)
