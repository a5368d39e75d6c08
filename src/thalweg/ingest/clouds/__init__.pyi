from .reader import (
    NO_USE as NO_USE,
    frame_of_remarks as frame_of_remarks,
    note_coarse as note_coarse,
    read_cloud as read_cloud,
    single_step_m as single_step_m,
)
from .reference import gather_reference as gather_reference, to_world as to_world
