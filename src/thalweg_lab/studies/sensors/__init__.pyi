from .laser_lines import multi_line_images as multi_line_images, write_images as write_images
