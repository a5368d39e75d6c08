"""Water level, banks, and the bed of a channel whose shape is known."""
