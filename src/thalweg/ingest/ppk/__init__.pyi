from .exports import write_solution as write_solution
from .options import PpkOptions as PpkOptions
from .rinex import describe_rinex as describe_rinex
from .solution import (
    PpkSolution as PpkSolution,
    base_extent_m as base_extent_m,
    check_inputs as check_inputs,
    run_ppk as run_ppk,
)
from .trust import (
    REFUSALS as REFUSALS,
    covariance_enu as covariance_enu,
    replace_covariances as replace_covariances,
)
