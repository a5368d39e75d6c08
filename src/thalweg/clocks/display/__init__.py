"""The camera's clock from photographs of a running clock."""
