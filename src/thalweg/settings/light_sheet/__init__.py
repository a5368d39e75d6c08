"""Sections of the underwater light-sheet sensor."""
