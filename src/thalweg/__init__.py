"""Thalweg: from the raw logs of a survey boat to models of riverbanks and riverbed with consistent standard deviations."""

__version__ = "0.1.0"
