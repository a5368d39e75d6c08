"""Figures and pages for people: one style, drawn from tables."""
