from .reader import read_nmea as read_nmea
