"""Least squares with robust weights, conditions, covariances and tests of both (`adjust`)."""
