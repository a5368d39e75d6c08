"""Lidar, positions and image times in the yard."""
