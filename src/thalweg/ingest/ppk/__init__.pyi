from .options import PpkOptions as PpkOptions
from .positions import replace_covariances as replace_covariances
from .rinex import describe_rinex as describe_rinex
from .solution import run_ppk as run_ppk
