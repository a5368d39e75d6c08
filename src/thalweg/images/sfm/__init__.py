"""Structure from motion by COLMAP."""
