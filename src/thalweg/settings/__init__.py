"""Campaign files: every key with unit, range and reason; all mistakes of a file at once."""
