"""Lidar returns as points in the world with a covariance each."""
