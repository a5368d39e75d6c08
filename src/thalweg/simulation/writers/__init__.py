"""Writers of raw logs, made from the format documents alone: they share no code with the readers."""
