"""Photographs of the yard."""
