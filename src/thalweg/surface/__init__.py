"""Surfaces: reference clouds become meshes, and points get signed distances from them."""
