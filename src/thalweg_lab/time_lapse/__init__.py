"""Photographs of the bank along the voyage."""
