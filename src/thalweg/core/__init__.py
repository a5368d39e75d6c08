"""Frames, time scales, tables, clouds and errors: what every other room stands on."""
