from .reader import NO_USE as NO_USE, read_cloud as read_cloud
from .reference import gather_reference as gather_reference, to_world as to_world
