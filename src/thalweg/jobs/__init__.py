"""What every batch job shares: logging, provenance, and the version of the code that made a result."""
