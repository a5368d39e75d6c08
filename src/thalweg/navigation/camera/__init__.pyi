from .image_predictions import predict_image_poses as predict_image_poses, stated_clock as stated_clock
from .image_times import antenna_in_camera as antenna_in_camera, time_images as time_images
from .mounts import lidar_mount_by_camera as lidar_mount_by_camera
from .trajectory import (
    CloudSettings as CloudSettings,
    camera_trajectory as camera_trajectory,
    states_with_velocity as states_with_velocity,
)
