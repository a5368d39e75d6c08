"""Coded markers on printed sheets: design, detection to sub-pixels."""
