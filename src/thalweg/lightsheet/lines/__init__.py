"""Laser lines in images: found, linked row to row, measured to sub-pixels with a sigma for each point."""
