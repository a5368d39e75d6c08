from .campaign_files import CampaignFiles as CampaignFiles
from .codehash import code_version as code_version
from .figures import read_figures as read_figures
from .forked import fork_scripts as fork_scripts
from .job import job_arguments as job_arguments, run_job as run_job
