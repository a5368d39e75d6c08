"""The camera's clock from what its photographs show: antenna positions, attitudes, tracks."""
