"""Thalweg: models of riverbanks and riverbed with tested standard deviations, from raw logs of a survey boat."""

__version__ = "0.1.0"
