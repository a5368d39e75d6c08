"""Figures of photographs, masks and control."""
