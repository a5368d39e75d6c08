"""How the boat moves, and where its sensors truly sit."""
