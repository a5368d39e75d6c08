"""Clouds as LAS and LAZ: own columns, chunks that are checked before they are read."""
