"""The echo sounder over a surveyed bed."""
