"""Calibration: the field of markers and cones, interior orientations, mounts, lever arms."""
