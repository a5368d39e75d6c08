"""Rays through window and water, the sensor model, strict intersection with covariance."""
