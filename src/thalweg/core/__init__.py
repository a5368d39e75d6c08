"""What every package stands on: frames, time, trajectories, covariance propagation, tables, errors
that users read.
"""
