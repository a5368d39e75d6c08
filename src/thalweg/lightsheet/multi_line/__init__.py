"""Fifteen lines at once: calibration of the fan and labels of lines."""
