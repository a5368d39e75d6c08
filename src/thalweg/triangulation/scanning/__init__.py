"""From single profiles to scans: poses, clouds, comparison with references, points in the world."""
