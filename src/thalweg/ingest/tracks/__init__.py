"""Tracks that other programs computed: RTKLIB, SBET, surveyed beds."""
