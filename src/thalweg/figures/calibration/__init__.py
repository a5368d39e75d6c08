"""Figures and page of calibration campaigns."""
