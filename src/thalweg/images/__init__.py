"""Photographs of the bank: masks, structure from motion, control points, adjustment with covariances."""
