"""First pictures of logs, and a page of recordings."""
