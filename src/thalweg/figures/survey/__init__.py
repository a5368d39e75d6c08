"""Figures of a survey: map, streams, trajectory, error budget."""
