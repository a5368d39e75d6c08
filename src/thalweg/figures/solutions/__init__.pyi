from .page import (
    Costs as Costs,
    computing_seconds as computing_seconds,
    trajectory_comparison_page as trajectory_comparison_page,
)
