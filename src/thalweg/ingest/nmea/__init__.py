"""NMEA 0183: positions, depths, time."""
