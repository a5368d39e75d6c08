"""What the instruments of the twin measure, with errors that are known."""
