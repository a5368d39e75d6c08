"""Mistakes of a campaign file with line, path and cure."""
