from .fixed_camera import fixed_camera_page as fixed_camera_page, pose_history as pose_history
from .photographs import (
    image_positions as image_positions,
    mask_sheet as mask_sheet,
    orientation_page as orientation_page,
)
