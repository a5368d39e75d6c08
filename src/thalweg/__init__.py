"""Thalweg: models of riverbanks and riverbed with standard deviations, from raw logs of a survey boat."""

__version__ = "1.1.0"
