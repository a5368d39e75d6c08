"""The light-sheet sensor in a tank: rendered lines, scanned objects, a strip of the bed."""
