from .bundle import (
    MARKS as MARKS,
    Control as Control,
    Layout as Layout,
    Problem as Problem,
    State as State,
    clean as clean,
    inner_constraints as inner_constraints,
    marks_model as marks_model,
    reduced as reduced,
    solve as solve,
    start_state as start_state,
    thinned as thinned,
)
from .description import (
    FieldDescription as FieldDescription,
    parse_field as parse_field,
    read_field as read_field,
)
from .job import (
    MeasuredField as MeasuredField,
    measure as measure,
    point_table as point_table,
    read_facts as read_facts,
    read_place as read_place,
    starting_camera as starting_camera,
    with_overview as with_overview,
    write_facts as write_facts,
)
from .network import (
    FieldNetwork as FieldNetwork,
    Start as Start,
    agreeing as agreeing,
    measure_field as measure_field,
    misfit_px as misfit_px,
    network_of as network_of,
    start_network as start_network,
)
from .points import FieldPoints as FieldPoints, read_points as read_points, write_points as write_points
from .rays import pose_from_rays as pose_from_rays
from .resection import (
    LARGEST_SIGMA0 as LARGEST_SIGMA0,
    LEAST_MARKS as LEAST_MARKS,
    Resected as Resected,
    resect as resect,
    resect_together as resect_together,
    start_misfit_px as start_misfit_px,
)
