from .bed import (
    TRUE_SOUNDINGS as TRUE_SOUNDINGS,
    simulate_bed_survey as simulate_bed_survey,
    simulate_echo as simulate_echo,
)
from .display_photos import simulate_display as simulate_display
from .effects import inside as inside
from .footprint import LIDAR_SHOTS as LIDAR_SHOTS, EchoKind as EchoKind
from .gnss import (
    Solution as Solution,
    antenna_errors_m as antenna_errors_m,
    multipath_errors_m as multipath_errors_m,
    simulate_gnss as simulate_gnss,
    stated_sigmas_m as stated_sigmas_m,
)
from .ins import (
    attitude_errors_rad as attitude_errors_rad,
    boat_field_mg as boat_field_mg,
    simulate_ins as simulate_ins,
    unstated_heading_errors_rad as unstated_heading_errors_rad,
    velocity_errors_mps as velocity_errors_mps,
)
from .lidar import (
    FIRING_S as FIRING_S,
    LASER_S as LASER_S,
    ROTATION_HZ as ROTATION_HZ,
    VLP_16 as VLP_16,
    Beams as Beams,
    Lasers as Lasers,
    LidarSensor as LidarSensor,
    Shots as Shots,
    simulate_lidar as simulate_lidar,
)
from .misstated import as_it_errs as as_it_errs
from .raw_gnss import (
    Receiver as Receiver,
    record_raw_gnss as record_raw_gnss,
    simulate_raw_gnss as simulate_raw_gnss,
)
from .tls import simulate_tls as simulate_tls
from .uav import simulate_uav as simulate_uav
