from .messages import find_messages as find_messages
from .reader import read_sbp as read_sbp
