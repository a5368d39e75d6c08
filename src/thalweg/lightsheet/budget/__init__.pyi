from . import budget as budget, checks as checks
from .budget import (
    TOTAL as TOTAL,
    TOTAL_CORRELATED as TOTAL_CORRELATED,
    budget_on_lines as budget_on_lines,
    budget_table as budget_table,
    calibrated as calibrated,
    depth_sigmas as depth_sigmas,
    design as design,
)
