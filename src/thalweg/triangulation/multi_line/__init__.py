"""Several lines of one laser: models of the lines, their adjustment, and which line a detection is."""
