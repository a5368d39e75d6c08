"""The calibration field of the digital twin: a yard with cones, printed markers and a boat in it."""
