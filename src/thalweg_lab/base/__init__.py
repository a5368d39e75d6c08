"""The river's course, reproducible random numbers."""
