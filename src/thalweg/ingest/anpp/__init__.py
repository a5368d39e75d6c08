"""Advanced Navigation packet protocol: states, raw sensors, integrity."""
