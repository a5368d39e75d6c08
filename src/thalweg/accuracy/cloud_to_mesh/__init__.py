"""Distances of a cloud from a reference: statistics, registration, prediction."""
