from .reader import NO_USE as NO_USE, corners_of_mesh as corners_of_mesh, read_cloud as read_cloud
from .reference import gather_reference as gather_reference, to_world as to_world
