from .budget import (
    COORDINATES as COORDINATES,
    CORRELATIONS as CORRELATIONS,
    GROUPS as GROUPS,
    STATUS as STATUS,
    TOTAL as TOTAL,
    Budget as Budget,
    Frame as Frame,
    Motion as Motion,
    covariance as covariance,
    frame_columns as frame_columns,
    influences as influences,
    rmse_mm as rmse_mm,
    totals_mm as totals_mm,
)
from .budget_file import read_budget as read_budget
from .tables import (
    RMSE as RMSE,
    digits as digits,
    label as label,
    long_table as long_table,
    row_names as row_names,
    text_lines as text_lines,
)
