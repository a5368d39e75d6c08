from .record import simulate_time_lapse as simulate_time_lapse
