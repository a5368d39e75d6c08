"""Objects scanned by the sheet: profiles, clouds, comparison with references."""
