"""The river of the twin: terrain, stones, plants, buildings, water."""
