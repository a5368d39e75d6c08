from .bathymetry import add_bathymetry_commands as add_bathymetry_commands
from .calibration import (
    add_calibration_commands as add_calibration_commands,
    describe_marked as describe_marked,
)
from .check import FirstJobs as FirstJobs
from .deformation import (
    add_deformation_commands as add_deformation_commands,
    summarise_changes as summarise_changes,
)
from .fetch import add_fetch_command as add_fetch_command
from .images import add_image_commands as add_image_commands
from .options import GEODETIC as GEODETIC, lengths as lengths
from .parser import EXAMPLES as EXAMPLES, Commands as Commands, refuse_overwriting as refuse_overwriting
from .results import add_cluster_commands as add_cluster_commands, add_result_commands as add_result_commands
from .survey import add_survey_commands as add_survey_commands
