from .packets import find_packets as find_packets
from .reader import read_anpp as read_anpp
