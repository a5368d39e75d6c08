"""Which file is what, and what it holds."""
