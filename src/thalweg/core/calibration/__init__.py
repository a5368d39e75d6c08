"""Calibrations of a boat as files: mounts with one joint covariance, and their imports."""
