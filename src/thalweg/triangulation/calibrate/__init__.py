"""Calibration of the light-sheet sensor: camera from marks, light sheet from a grid in two levels."""
