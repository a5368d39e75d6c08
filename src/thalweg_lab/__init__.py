"""The laboratory: digital twin, studies, comparisons with the truth, ledger of published numbers."""
