"""Control points in photographs."""
