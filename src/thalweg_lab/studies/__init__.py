"""Studies over many simulated surveys."""
