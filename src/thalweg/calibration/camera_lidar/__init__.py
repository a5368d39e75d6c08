"""Camera and lidar against each other, from cones seen by both (P2)."""
