from .compose import Composed as Composed, compose as compose
from .files import (
    PANORAMAS as PANORAMAS,
    cloud_ranges as cloud_ranges,
    fill_gaps as fill_gaps,
    make_panoramas as make_panoramas,
    reading_that_fits as reading_that_fits,
    rig_photographs as rig_photographs,
    write_panorama as write_panorama,
)
from .places import PlacedFiles as PlacedFiles, place_rig_files as place_rig_files
from .sphere import (
    default_width_px as default_width_px,
    level_attitude as level_attitude,
    pixels_of as pixels_of,
    sphere_rays as sphere_rays,
)
