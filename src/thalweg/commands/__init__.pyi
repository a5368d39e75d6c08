from .bathymetry import add_bathymetry_commands as add_bathymetry_commands
from .budget import add_budget_command as add_budget_command
from .calibration import add_calibration_commands as add_calibration_commands
from .check import add_check_command as add_check_command
from .deformation import add_deformation_commands as add_deformation_commands
from .describe import add_describe_command as add_describe_command
from .fetch import add_fetch_command as add_fetch_command
from .images import add_image_commands as add_image_commands
from .new_campaign import (
    add_new_campaign_command as add_new_campaign_command,
    add_schema_command as add_schema_command,
)
from .parser import (
    EXAMPLES as EXAMPLES,
    EXIT_MISTAKE as EXIT_MISTAKE,
    Commands as Commands,
    refuse_overwriting as refuse_overwriting,
)
from .results import (
    add_cluster_commands as add_cluster_commands,
    add_result_commands as add_result_commands,
    add_summary_command as add_summary_command,
)
from .run import add_run_commands as add_run_commands
from .survey import add_survey_commands as add_survey_commands
