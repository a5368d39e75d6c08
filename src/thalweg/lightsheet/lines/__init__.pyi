from .albedo import pooled_shift as pooled_shift, without_shift as without_shift
from .detect import detect_lines as detect_lines
from .image import green_image as green_image
from .points import LINE_POINTS as LINE_POINTS, LinePoints as LinePoints
from .settings import LineFlag as LineFlag, LineSettings as LineSettings, Method as Method
