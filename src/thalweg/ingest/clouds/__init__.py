"""Point clouds of others: LAS, PLY, E57, PCD; reference scans in the local frame."""
