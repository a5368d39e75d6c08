"""How accurate a cloud is, and whether it knew."""
