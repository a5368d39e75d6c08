"""Time-lapse images of the river bank by the boat's camera, and the control points in them."""
