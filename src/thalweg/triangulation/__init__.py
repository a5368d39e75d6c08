"""The underwater laser light-sheet sensor: optics, lines, calibration, profiles and scans."""
