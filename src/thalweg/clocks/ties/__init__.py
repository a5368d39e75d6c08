"""Clock models from tie points, triggers and tables kept by hand."""
