from .soundings import (
    REASONS as REASONS,
    S44 as S44,
    SOUNDINGS as SOUNDINGS,
    Sound as Sound,
    Transducer as Transducer,
    axis_range_m as axis_range_m,
    locate_soundings as locate_soundings,
    s44_orders as s44_orders,
    speed_of_sound_mps as speed_of_sound_mps,
    with_bed_normals as with_bed_normals,
)
