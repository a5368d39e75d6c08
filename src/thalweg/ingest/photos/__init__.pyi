from .exif import CivilStamp as CivilStamp, ImageHead as ImageHead, read_head as read_head
from .files import (
    Images as Images,
    by_any_name as by_any_name,
    find_images as find_images,
    list_images as list_images,
    named_images as named_images,
    natural_key as natural_key,
    read_mask as read_mask,
)
from .stamps import IMAGE_STAMPS as IMAGE_STAMPS, read_image_stamps as read_image_stamps
from .video import VideoFrames as VideoFrames, container_time as container_time, write_frames as write_frames
