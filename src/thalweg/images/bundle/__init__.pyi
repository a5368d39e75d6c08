from .adjustment import (
    AdjustedBlock as AdjustedBlock,
    adjust_block as adjust_block,
    pose_covariance as pose_covariance,
)
from .checks import Interiors as Interiors
from .job import (
    CONTROL_COLUMNS as CONTROL_COLUMNS,
    Boat as Boat,
    Pieces as Pieces,
    adjust_campaign as adjust_campaign,
    adjust_pieces as adjust_pieces,
    grey_loader as grey_loader,
    interiors_of as interiors_of,
    marks_of_campaign as marks_of_campaign,
    marks_of_pieces as marks_of_pieces,
    mask_loader as mask_loader,
    pieces_tables as pieces_tables,
    read_interiors as read_interiors,
    read_pieces as read_pieces,
    statistics_of as statistics_of,
    summary_text as summary_text,
    write_cameras as write_cameras,
)
from .problem import (
    Problem as Problem,
    RigFrames as RigFrames,
    rig_frames as rig_frames,
    with_shared_errors as with_shared_errors,
)
from .run import Oriented as Oriented
