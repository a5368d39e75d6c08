"""Trajectories from oriented photographs."""
