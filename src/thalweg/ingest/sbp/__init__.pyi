from .messages import SbpRecords as SbpRecords, collect as collect, find_messages as find_messages
from .reader import base_positions as base_positions, read_sbp as read_sbp
