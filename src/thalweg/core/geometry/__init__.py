"""Meshes, rays and polygons."""
