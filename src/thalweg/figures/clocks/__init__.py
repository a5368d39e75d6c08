"""Figures of clocks."""
