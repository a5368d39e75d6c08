"""Figures and page of the comparison with a reference."""
