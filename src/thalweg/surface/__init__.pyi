from .area import Area as Area
from .cloud_to_mesh import Distances as Distances, Surface as Surface
from .meshing import BankFrame as BankFrame
from .reference import (
    area_margin_m as area_margin_m,
    compare_files as compare_files,
    mesh_reference as mesh_reference,
    read_reference as read_reference,
)
