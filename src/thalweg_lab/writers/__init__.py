"""Logs in the instruments' own formats, written independently of the readers."""
