"""Thalweg: from raw logs of a survey boat to models of riverbanks and riverbed with tested standard deviations."""

__version__ = "0.1.0"
