"""What the sensor's parameters cost in depth."""
