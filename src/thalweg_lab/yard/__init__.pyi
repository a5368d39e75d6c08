from .layout import (
    ANTENNA as ANTENNA,
    ANTENNA_OFFSET_M as ANTENNA_OFFSET_M,
    CONE_M as CONE_M,
    FLAT as FLAT,
    FLAT_MODULE_M as FLAT_MODULE_M,
    ICS_HEIGHT_M as ICS_HEIGHT_M,
    Field as Field,
    FieldCone as FieldCone,
    Plane as Plane,
    Sheet as Sheet,
    build_field as build_field,
    field_of as field_of,
)
from .scene import (
    FieldScene as FieldScene,
    Yard as Yard,
    boat_mesh as boat_mesh,
    field_scene as field_scene,
    people as people,
    recorded as recorded,
    sensor_mesh as sensor_mesh,
    with_boat as with_boat,
    yard_of as yard_of,
)
from .tour import boat_views as boat_views, looking as looking, tour as tour
