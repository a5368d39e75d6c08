"""Photographs and the times that their files carry."""
