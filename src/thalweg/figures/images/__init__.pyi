from .fixed_camera import fixed_camera_page as fixed_camera_page, pose_history as pose_history
from .photographs import (
    example_names as example_names,
    image_positions as image_positions,
    mask_view as mask_view,
    orientation_page as orientation_page,
    read_examples as read_examples,
)
