"""Figures and page of the light-sheet sensor."""
