"""Trajectories from INS, GNSS and photographs by a smoother."""
