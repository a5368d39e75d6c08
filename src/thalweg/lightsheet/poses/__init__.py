"""Poses of the sensor: panels, files of others."""
