"""Camera, window and sheet from a grid object in two levels."""
