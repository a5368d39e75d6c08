"""The lens of the sensor's camera from pictures of a marker field."""
