"""Raw logs in, documented tables and integrity reports out: one adapter an instrument format."""
