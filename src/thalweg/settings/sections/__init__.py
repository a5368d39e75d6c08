"""Sections of a campaign file, but for images, light sheet and twin."""
