from .campaign_files import CampaignFiles as CampaignFiles, pattern_of_epochs as pattern_of_epochs
from .cluster import (
    cancel_jobs as cancel_jobs,
    check_cluster as check_cluster,
    check_nodes as check_nodes,
    cures_in as cures_in,
    jobs_of as jobs_of,
    living_driver as living_driver,
    refuse_shell as refuse_shell,
    start_driver as start_driver,
    start_snakemake_once as start_snakemake_once,
    unfinished as unfinished,
)
from .codehash import code_version as code_version
from .costs import (
    Measured as Measured,
    costs_of as costs_of,
    fitted as fitted,
    memory_now_mb as memory_now_mb,
    per_rule as per_rule,
    predicted as predicted,
    read_costs as read_costs,
)
from .failures import tell_failures_last as tell_failures_last
from .figures import as_format as as_format, read_figures as read_figures
from .forked import fork_scripts as fork_scripts
from .job import job_arguments as job_arguments, run_job as run_job
from .provenance import other_versions as other_versions, verify as verify
from .staging import use_scratch as use_scratch
