"""Values and mounts that several sections share."""
