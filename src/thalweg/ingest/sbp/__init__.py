"""Swift binary protocol: positions, observations, integrity."""
