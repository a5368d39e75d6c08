from . import refractive_index as refractive_index
from .derivatives import point_derivatives as point_derivatives, sheet_derivatives as sheet_derivatives
from .interfaces import refract as refract, trace as trace
from .intersection import SheetPoints as SheetPoints, intersect as intersect, project as project
from .lookup import write_look_up_table as write_look_up_table
from .refraction import (
    Status as Status,
    directions_to_points as directions_to_points,
    refract_to_water as refract_to_water,
)
from .refractive_index import (
    WaterState as WaterState,
    air as air,
    in_measured_water as in_measured_water,
    water as water,
)
from .sensor import (
    CAMERA as CAMERA,
    FLIP as FLIP,
    LASER as LASER,
    LENS as LENS,
    PARAMETERS as PARAMETERS,
    RESOURCES as RESOURCES,
    WINDOW as WINDOW,
    LightSheet as LightSheet,
    Sensor as Sensor,
    Window as Window,
    paper_3 as paper_3,
    paper_4 as paper_4,
    read_sensor as read_sensor,
    write_sensor as write_sensor,
)
from .volume import (
    DepthLine as DepthLine,
    PictureGrid as PictureGrid,
    depth_lines as depth_lines,
    fan_angles as fan_angles,
    measurement_volume as measurement_volume,
    picture_grid as picture_grid,
    sheet_in_water as sheet_in_water,
)
