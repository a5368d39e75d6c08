"""Trajectories from INS attitudes and GNSS positions, and how their errors behave."""
