from .budget import (
    SIGMA_LINE_PX as SIGMA_LINE_PX,
    TOTAL as TOTAL,
    TOTAL_CORRELATED as TOTAL_CORRELATED,
    budget_on_lines as budget_on_lines,
    budget_table as budget_table,
)
