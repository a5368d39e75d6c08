"""Lidar points: from the scanner frame into the world, each with its own pose and covariance."""
