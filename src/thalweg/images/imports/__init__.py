"""Finished orientations of COLMAP, Metashape and tables."""
