"""Results against the truth of the twin."""
