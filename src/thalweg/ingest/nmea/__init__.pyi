from .reader import days_of_date as days_of_date, read_nmea as read_nmea, second_of_day as second_of_day
