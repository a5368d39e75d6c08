"""Interior orientation: perspective and fisheye models, and the files that hold them."""
