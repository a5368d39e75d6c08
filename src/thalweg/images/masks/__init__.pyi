from .images import (
    known_camera as known_camera,
    make_masks as make_masks,
    make_masks_of_cameras as make_masks_of_cameras,
    size_of as size_of,
)
