from .budget import (
    CORRELATIONS as CORRELATIONS,
    GROUPS as GROUPS,
    TOTAL as TOTAL,
    Budget as Budget,
    rmse_mm as rmse_mm,
    totals_mm as totals_mm,
)
from .budget_file import read_budget as read_budget
from .budget_page import (
    group_shares as group_shares,
    latex as latex,
    long_table as long_table,
    marks_line as marks_line,
    page as page,
    statements as statements,
    terminal_text as terminal_text,
    text_lines as text_lines,
    what_the_cells_tell as what_the_cells_tell,
)
from .published import BY_CHOICE as BY_CHOICE, read_published as read_published
from .reconstruct import (
    left_out as left_out,
    published_setup as published_setup,
    reconstruct as reconstruct,
    solution_facts as solution_facts,
)
