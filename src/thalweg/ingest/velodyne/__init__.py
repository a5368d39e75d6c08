"""Velodyne VLP-16: packets to points on GPS time."""
