"""The underwater light-sheet sensor: refraction, laser lines, calibration, scans."""
