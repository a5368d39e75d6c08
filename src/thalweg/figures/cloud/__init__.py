"""Figures of clouds: overview, quality, footprints, views."""
