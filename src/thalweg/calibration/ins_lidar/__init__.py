"""The lidar on the moving boat, from a run around cones."""
