"""Camera and lidar by checkerboards."""
