from .device import TrueRig as TrueRig, true_rig as true_rig
from .record import simulate_dual_fisheye as simulate_dual_fisheye, simulate_rig_field as simulate_rig_field
from .room import room_marks as room_marks, room_points as room_points, room_poses as room_poses
