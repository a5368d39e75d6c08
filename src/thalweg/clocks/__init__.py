"""One GPS time axis for all streams."""
