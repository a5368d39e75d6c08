"""Adjustment of image blocks with control, and the covariance of every pose."""
