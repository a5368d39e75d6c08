"""Surfaces: meshes of reference clouds, and distances from them."""
