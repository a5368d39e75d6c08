"""Streams beside each other: offset, drift, jitter, gaps, lag."""
