from .camera import LensRays as LensRays, exposed as exposed
from .images import (
    BOAT_SENSOR_MM as BOAT_SENSOR_MM,
    FULL_FRAME_MM as FULL_FRAME_MM,
    draw_field_images as draw_field_images,
    mount_of as mount_of,
    run_name as run_name,
    simulate_field_images as simulate_field_images,
    simulate_synthetic_view as simulate_synthetic_view,
    true_camera as true_camera,
)
from .render import Photographer as Photographer, changes as changes, turned as turned
