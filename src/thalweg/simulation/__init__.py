"""The digital twin: river, boat, sensors, writers of raw logs, truth."""
