from .motion import (
    LEAD_S as LEAD_S,
    FieldRun as FieldRun,
    Motion as Motion,
    Voyage as Voyage,
    epochs as epochs,
    motion_of as motion_of,
    standing as standing,
    start_gps_s as start_gps_s,
    start_unix as start_unix,
    static_seed as static_seed,
)
from .truth import (
    longest_correlation_s as longest_correlation_s,
    read_true_mounts as read_true_mounts,
    simulate_voyage as simulate_voyage,
    true_mounts as true_mounts,
    true_trajectory as true_trajectory,
    write_effects as write_effects,
    write_true_mounts as write_true_mounts,
)
