from .record import simulate_time_lapse as simulate_time_lapse
from .view import simulate_view as simulate_view
