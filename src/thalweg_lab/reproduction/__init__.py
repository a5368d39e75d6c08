"""The ledger: published numbers beside those of the twin."""
